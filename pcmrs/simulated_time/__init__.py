"""Time that is simulated: an event loop in which waiting costs nothing, and the clocks that read it."""
