"""The parts of mobo.py; they only need the standard library."""
