"""Who speaks and when, and the descriptors of a voice."""
