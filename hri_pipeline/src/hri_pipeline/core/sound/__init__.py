"""Sound: format, stream, level, direction, separation."""
