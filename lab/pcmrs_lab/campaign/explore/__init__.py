"""Random procedures under random faults in simulated time, with invariants that are looked at after every event."""
