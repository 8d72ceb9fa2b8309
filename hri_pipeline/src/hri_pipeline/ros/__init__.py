"""The ROS side: messages, topics, parameters and diagnostics."""
