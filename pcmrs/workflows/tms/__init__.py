"""Stimulation: an armed stimulator, pulses that are given only at their place, and what they evoke."""
