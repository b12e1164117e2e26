"""The simulated muscle and its electromyogram."""
