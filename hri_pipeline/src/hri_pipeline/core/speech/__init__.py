"""What is said: recognisers and the process that they run in."""
