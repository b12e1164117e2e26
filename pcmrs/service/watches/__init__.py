"""Watches of the daemon: nodes, poses, the lease, its own event loop and its disk."""
