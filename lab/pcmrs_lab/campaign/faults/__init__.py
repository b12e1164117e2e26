"""Injections of the faults of the catalogue: one module for each class or topic."""
