"""What the tuner offers to clients: actions, services and parameters."""
