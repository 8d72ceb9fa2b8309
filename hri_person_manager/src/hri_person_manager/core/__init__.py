"""Computation without ROS; time is always an argument."""
