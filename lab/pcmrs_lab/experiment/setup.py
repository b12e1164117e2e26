"""What every experiment is told: the plan, the workflow, the simulation's seed, speed and drivers, further settings."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal

from pcmrs.testing.plan import Plan

PATIENT_DEADMAN = "robot.deadman=0.5"
"""An experiment is not about the deadman, and shares the machine with whatever else is computed there."""

ShowProgress = Callable[[str, int, int], None]
"""Told what is being done, and how many of how many steps are done."""


Drivers = Literal["builtin", "virtual"]
"""How the daemon reaches arm and tracker: simulated ones of its own, or virtual ones by the drivers of real ones."""

SETTINGS_OF: dict[Drivers, tuple[str, ...]] = {
    "builtin": (),
    "virtual": ("robot.driver=kst", "tracker.driver=ndi"),
}


@dataclass(frozen=True, slots=True)
class ExperimentSetup:
    """One experiment on a simulated cell.

    Attributes:
        plan: Landmarks and poses.
        workflow: Name of the workflow.
        seed: Of the simulated errors.
        rate: Seconds of the simulated cell per second of the machine; 1 with virtual devices.
        drivers: Built-in devices, or virtual ones that speak the protocols of real ones.
        overrides: Further settings of the daemon, ``key=value`` each.
        progress: Told about every step.
    """

    plan: Plan
    workflow: str
    seed: int
    rate: float
    drivers: Drivers
    overrides: Sequence[str]
    progress: ShowProgress

    def settings(self) -> list[str]:
        """What differs from the default configuration, for the daemon and for the report."""
        return [*at_rate(self.rate), *SETTINGS_OF[self.drivers], *self.overrides]


def at_rate(rate: float) -> list[str]:
    """Settings of a simulated cell that is `rate` times as fast as real time."""
    return [f"cell.rate={rate:g}", PATIENT_DEADMAN]
