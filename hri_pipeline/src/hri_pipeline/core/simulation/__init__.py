"""Simulated people: scenes, what is true in them at a time, and what sensors would report of them."""
