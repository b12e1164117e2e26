"""Processes beside the daemon: its nodes, heart, planner, recorder and console."""
