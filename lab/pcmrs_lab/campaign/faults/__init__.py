"""How the faults of the catalogue are injected: one module for each class."""
