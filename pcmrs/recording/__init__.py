"""Recordings of a cell's bus as MCAP files, their repair, and their playback."""
