"""Fault campaign: injects every fault of the catalogue into a real cell and checks the response."""
