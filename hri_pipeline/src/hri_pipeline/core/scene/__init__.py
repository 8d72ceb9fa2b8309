"""Scenes of people who are thought of, and what sensors would tell of them."""
