"""The human as a chain of links: its dimensions, its stature, its URDF."""
