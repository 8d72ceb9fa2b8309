"""Faces: finding, following, their geometry, gaze, action units, expression, age and gender."""
