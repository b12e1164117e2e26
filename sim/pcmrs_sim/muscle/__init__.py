"""The simulated muscle: what its electromyogram shows, pulse or no pulse."""
