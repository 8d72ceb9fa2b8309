"""Forward and inverse kinematics of the human model."""
