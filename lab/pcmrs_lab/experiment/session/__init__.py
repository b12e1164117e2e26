"""A whole session on a simulated cell: who asks for what, what the journal says of it, and the folder it leaves."""
