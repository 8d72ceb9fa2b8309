"""What a body expresses: attitude, posture, gesture."""
