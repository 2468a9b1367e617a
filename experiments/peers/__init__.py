"""Comparison with the optimisers of the field."""
