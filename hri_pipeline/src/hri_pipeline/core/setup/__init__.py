"""Whether a set-up can work, and why not."""
