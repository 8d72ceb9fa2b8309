"""From key points to the joints of the chain."""
