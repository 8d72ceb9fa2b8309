"""Child processes that are watched."""
