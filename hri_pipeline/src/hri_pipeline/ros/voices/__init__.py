"""Voices: topics and the node."""
