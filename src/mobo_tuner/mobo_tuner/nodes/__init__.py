"""The nodes: thin shells around the core, one module each."""
