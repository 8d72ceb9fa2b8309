"""Bodies: detection, tracking, skeletons."""
