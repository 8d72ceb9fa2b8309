"""Sound that comes in, and its source."""
