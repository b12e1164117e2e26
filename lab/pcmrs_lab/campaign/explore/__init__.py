"""Random procedures under random faults in simulated time; invariants are checked after every event."""
