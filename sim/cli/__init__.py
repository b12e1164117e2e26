"""The commands of `pcmrs-sim`: virtual devices that speak the real protocols."""
