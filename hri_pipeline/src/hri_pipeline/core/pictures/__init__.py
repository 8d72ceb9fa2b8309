"""Sources of images, and drawing on them."""
