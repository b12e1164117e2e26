"""What the daemon watches: nodes, poses, the lease, its own loop and its disk."""
