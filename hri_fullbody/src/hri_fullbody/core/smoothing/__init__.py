"""From noisy key points to smooth ones."""
