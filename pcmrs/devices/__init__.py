"""Devices: what the workflow may ask of them, how they are reached, and what is checked on the way."""
