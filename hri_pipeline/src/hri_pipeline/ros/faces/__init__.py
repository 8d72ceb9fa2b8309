"""Faces: topics, pictures, galleries."""
