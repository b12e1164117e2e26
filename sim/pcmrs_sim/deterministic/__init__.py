"""Simulated time: the whole cell in one process, on one seeded clock, over a network that can fail."""
