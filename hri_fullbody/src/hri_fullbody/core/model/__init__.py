"""The kinematic model of a human: dimensions, anthropometry, URDF."""
