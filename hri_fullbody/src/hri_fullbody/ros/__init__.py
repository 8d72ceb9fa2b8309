"""The ROS side of body perception."""
