"""Depth cameras of the detector of the scene."""
