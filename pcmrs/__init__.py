"""PCMRS: a process-controlled medical robotic system. Research software, not a medical device."""

__version__ = "0.1.0"
