"""Hot-spot and motor threshold: the code that this workflow adds to RATMS is in `pcmrs.workflows.tms`."""

from __future__ import annotations

from pcmrs.dispatcher import Registry
from pcmrs.workflows.cell import Cell
from pcmrs.workflows.data import PlacementData
from pcmrs.workflows.tms.arming import register_arming
from pcmrs.workflows.tms.coil_alignment import register_coil_alignment
from pcmrs.workflows.tms.data import Data, register_device_checks, settle
from pcmrs.workflows.tms.hotspot import register_hotspot
from pcmrs.workflows.tms.intensity import register_intensity
from pcmrs.workflows.tms.pulse import register_pulse
from pcmrs.workflows.tms.threshold import register_threshold

__all__ = ["Data", "register", "settle"]


def register(registry: Registry[Cell, PlacementData]) -> None:
    """Register the names that the blueprint uses in addition to those of all procedures."""
    register_device_checks(registry)
    register_intensity(registry)
    register_arming(registry)
    register_coil_alignment(registry)
    register_pulse(registry)
    register_hotspot(registry)
    register_threshold(registry)
