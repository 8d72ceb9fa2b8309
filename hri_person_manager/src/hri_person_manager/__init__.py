"""Persons: who the faces, bodies and voices belong to, and where they are."""
