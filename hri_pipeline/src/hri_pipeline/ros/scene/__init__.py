"""The simulated scene as a node."""
