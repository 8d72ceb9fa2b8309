"""Person detector and pose network."""
