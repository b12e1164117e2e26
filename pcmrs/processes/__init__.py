"""Start of child processes: as a new Python, or by a server that forks them."""
