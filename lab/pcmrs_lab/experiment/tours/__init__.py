"""Tours of everything that a workflow can answer: on the dispatcher alone, and through a running cell."""
