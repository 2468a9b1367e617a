"""One run: its start, its loop, its attempts at an evaluation, its end."""
