"""Faults of the muscle: row S14 of the fault catalogue, and preactivation, which makes responses unusable."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from pcmrs_sim.faults.fault import Fault, FaultTarget, number, switch

LARGEST_EMG_UV = 1000.0
"""Electromyogram (rms) of a strong contraction, uV."""


def _no_mep(cell: FaultTarget, arguments: Mapping[str, Any]) -> None:
    cell.world.muscle.silent = switch(arguments, "on")


def _preactivation(cell: FaultTarget, arguments: Mapping[str, Any]) -> None:
    rms = number(arguments, "microvolts", 0.0, LARGEST_EMG_UV) * 1e-6
    cell.world.muscle.preactivate(rms, cell.world.time)


FAULTS = (
    Fault("no_mep", "S14", "Pulses have no effect on the muscle.", ("on",), _no_mep),
    Fault(
        "preactivation",
        "S14",
        "The muscle is tense, with an EMG of this rms, uV; 0 relaxes it.",
        ("microvolts",),
        _preactivation,
    ),
)
"""Faults of the muscle, for the registry `pcmrs_sim.faults.FAULTS`."""
