"""Arm models, inverse kinematics and trajectories.

Import the modules directly: `arms`, `urdf` and `mjcf` need neither Pinocchio nor Ruckig.
"""
