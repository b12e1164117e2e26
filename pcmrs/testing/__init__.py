"""Tools for testing your own workflow, driver or planner; see docs/testing.md.

Nothing here is needed by a cell that runs.
"""
