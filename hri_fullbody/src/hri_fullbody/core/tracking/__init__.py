"""Tracking of several bodies from image to image."""
