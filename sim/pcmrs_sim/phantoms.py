"""The phantoms that a simulated cell can be set up with."""

from pcmrs_sim.femur import FEMUR
from pcmrs_sim.head import HEAD

PHANTOMS = {"head": HEAD, "femur": FEMUR}
"""By the name that the setting ``sim.phantom`` has."""
