"""Simulated time: an event loop in which waiting costs nothing, and the clocks that read its time."""
