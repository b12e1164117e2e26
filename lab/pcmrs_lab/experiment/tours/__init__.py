"""Tours of all responses of a workflow: on the dispatcher alone, and through a running cell."""
