"""Simulated subjects of stimulation: response of a muscle to a coil."""
