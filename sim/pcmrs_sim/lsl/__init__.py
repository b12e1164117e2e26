"""The simulated muscle on Lab Streaming Layer: its electromyogram, and the pulses that it answers."""
