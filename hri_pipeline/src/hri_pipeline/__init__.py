"""Face, voice and interaction perception, and the core that every package of the stack shares."""
