"""Evaluation on real pictures: labels, and the figures made of them. No node imports it."""
