"""String-command links over UDP and TCP for planners, control panels, viewers and mixed reality."""
