"""What the nodes share: parameters, quality of service, conversions, and how a node's process runs."""
