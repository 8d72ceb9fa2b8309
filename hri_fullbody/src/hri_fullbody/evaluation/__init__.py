"""Measures the body pipeline on recorded motion. Nothing here runs in a node."""
