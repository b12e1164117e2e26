"""From one run of the daemon to the next: what the journal says, and how it is written."""
