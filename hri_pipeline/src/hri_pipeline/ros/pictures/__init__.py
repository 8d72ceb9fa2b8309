"""The source of images, and the overlay."""
