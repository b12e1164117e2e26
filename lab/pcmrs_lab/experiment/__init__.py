"""The paper's experiments, run through a daemon of their own by an external planner over UDP."""
