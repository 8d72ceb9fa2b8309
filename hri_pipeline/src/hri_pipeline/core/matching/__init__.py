"""Which faces, bodies and voices belong to the same human."""
