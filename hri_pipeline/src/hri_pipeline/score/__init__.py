"""Bags of people: written, read, and scored against the truth."""
