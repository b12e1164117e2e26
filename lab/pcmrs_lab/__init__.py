"""The laboratory: fault campaign, experiments, exploration in simulated time."""
