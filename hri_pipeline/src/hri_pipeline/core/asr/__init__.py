"""What is said: recognisers of speech and the processes that they run in."""
