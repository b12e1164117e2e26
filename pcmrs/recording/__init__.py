"""Recordings: what a cell says on its bus in MCAP files, their repair, and playing them again."""
