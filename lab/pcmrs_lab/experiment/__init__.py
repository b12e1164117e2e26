"""Experiments of the paper: each runs on its own daemon, commanded by an external planner over UDP."""
