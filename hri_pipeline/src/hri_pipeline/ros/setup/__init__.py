"""The check of a set-up, and the start of a bag."""
