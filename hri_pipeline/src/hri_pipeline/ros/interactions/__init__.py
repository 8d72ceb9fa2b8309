"""Gaze, groups and engagement: topics and the node."""
