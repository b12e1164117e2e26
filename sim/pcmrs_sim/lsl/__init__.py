"""The simulated muscle on Lab Streaming Layer: its electromyogram, and the pulses that it answers.

Samples are in uV and have stamps of the library's clock. A pulse is a marker with number and intensity.
"""
