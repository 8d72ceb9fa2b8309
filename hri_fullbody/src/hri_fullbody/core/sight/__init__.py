"""Where people are in an image, and what the pose network sees in one window of it."""
