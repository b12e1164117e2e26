"""The phantoms that a simulated cell can be set up with."""

from sim.femur import FEMUR
from sim.head import HEAD

PHANTOMS = {"head": HEAD, "femur": FEMUR}
"""By the name that the setting ``sim.phantom`` has."""
