"""Helpers of the project: what `mobo.py` is made of (standard library only), and generators."""
