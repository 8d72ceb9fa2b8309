"""Recognising faces, and keeping who they are."""
