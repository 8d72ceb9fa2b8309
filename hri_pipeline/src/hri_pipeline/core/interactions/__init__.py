"""Who looks at whom, who stands together, who is engaged with the robot."""
