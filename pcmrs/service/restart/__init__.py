"""State from one run of the daemon to the next, kept in the journal."""
