"""The ROS side: topics, frames, parameters."""
