"""Common setup of all experiments: plan, workflow, seed, speed and drivers of the simulation, further settings."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal

from pcmrs.testing.plan import Plan

PATIENT_DEADMAN = "robot.deadman=1.0"
"""Long deadman: an experiment does not test the deadman, and beside other programs a process may wait half a second."""

ShowProgress = Callable[[str, int, int], None]
"""Called with the current step, and with how many of how many steps are done."""


Drivers = Literal["builtin", "virtual"]
"""Devices of the daemon: built-in simulated ones, or virtual ones through the drivers of real devices."""

SETTINGS_OF: dict[Drivers, tuple[str, ...]] = {
    "builtin": (),
    "virtual": ("robot.driver=kst", "tracker.driver=ndi"),
}


@dataclass(frozen=True, slots=True)
class ExperimentSetup:
    """ExperimentSetup of one experiment on a simulated cell.

    Attributes:
        plan: Landmarks and poses.
        workflow: Name of the workflow.
        seed: Seed of the simulated errors.
        rate: Seconds of the simulated cell per second of the machine; 1 with virtual devices.
        drivers: Built-in devices, or virtual ones that speak the protocols of real ones.
        overrides: Further settings of the daemon, ``key=value`` each.
        progress: Called at every step.
    """

    plan: Plan
    workflow: str
    seed: int
    rate: float
    drivers: Drivers
    overrides: Sequence[str]
    progress: ShowProgress

    def settings(self) -> list[str]:
        """Return the settings that differ from the default configuration, for the daemon and for the report."""
        return [*at_rate(self.rate), *SETTINGS_OF[self.drivers], *self.overrides]


def at_rate(rate: float) -> list[str]:
    """Return the settings of a simulated cell that is `rate` times as fast as real time."""
    return [f"cell.rate={rate:g}", PATIENT_DEADMAN]
