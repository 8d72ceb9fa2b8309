"""Perception of bodies, free of ROS."""
