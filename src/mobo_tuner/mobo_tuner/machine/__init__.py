"""The machine's side: the server of its interfaces and its backends, without the optimiser."""
