"""Simulated subjects of magnetic stimulation: response of a muscle to pulses from any pose of the coil."""
