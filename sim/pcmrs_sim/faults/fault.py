"""Injectable faults, and the cells in which they can be brought about."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Protocol

from pcmrs.kinematics.arms import ArmFacts
from pcmrs_sim.robot_faults import RobotFaults
from pcmrs_sim.tracker import SimTracker
from pcmrs_sim.world import World


class Faulty(Protocol):
    """A cell, as faults change it.

    Attributes:
        facts: The arm.
        world: The truth.
        tracker: Has faults of its own.
    """

    facts: ArmFacts
    world: World
    tracker: SimTracker

    @property
    def robot_faults(self) -> RobotFaults:
        """What is wrong with the robot."""

    def cut_robot(self, cut: bool) -> None:
        """Cut the robot's link, or restore it."""


@dataclass(frozen=True)
class Fault:
    """One fault of the catalogue that can be brought about in a simulated cell, and ended.

    Attributes:
        name: By which it is asked for.
        row: Of the fault catalogue, such as ``S5``.
        help: One line: what happens.
        arguments: Names of its arguments, in the order in which a line of text gives them.
        apply: Brings it about or ends it; raises `DeviceError` for an argument that it cannot use.
        also: Other rows of the catalogue that it brings about.
    """

    name: str
    row: str
    help: str
    arguments: tuple[str, ...]
    apply: Callable[[Faulty, Mapping[str, Any]], None]
    also: tuple[str, ...] = ()

    @property
    def rows(self) -> tuple[str, ...]:
        """All rows of the catalogue that it brings about."""
        return (self.row, *self.also)
