"""A whole session with stimulation on a simulated cell."""
