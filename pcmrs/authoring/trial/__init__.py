"""Trying a workflow out: a step at a time, at random, or by a tour of everything that it can answer."""
