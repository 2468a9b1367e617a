"""Shared parts of the nodes: interfaces, parameters, quality of service, conversions, processes."""
