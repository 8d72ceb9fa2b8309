"""Which body is which, from image to image."""
