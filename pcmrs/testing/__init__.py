"""Tools for testing your own workflow, driver or planner."""
