"""What a daemon says of itself: its health, metrics, and the word to its service manager."""
