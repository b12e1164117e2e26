"""Injectable faults, and the cells in which they can be brought about.

Arguments of faults, as words of a line or as data from the bus.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

from pcmrs.errors import DeviceError
from pcmrs.kinematics.arms import ArmFacts
from pcmrs_sim.robot_faults import RobotFaults
from pcmrs_sim.tracker import SimTracker
from pcmrs_sim.world import World


def switch(arguments: Mapping[str, Any], name: str) -> bool:
    """A truth value; true where it is left out.

    Raises:
        DeviceError: It is something else.
    """
    value = arguments.get(name, True)
    if isinstance(value, bool):
        return value
    raise DeviceError(f"The argument {name} is {value!r}, must be on or off.", argument=name, value=value)


def number(arguments: Mapping[str, Any], name: str, lowest: float, highest: float) -> float:
    """A number within a range.

    Raises:
        DeviceError: It is none, or outside.
    """
    value = arguments.get(name)
    if isinstance(value, int | float) and not isinstance(value, bool) and lowest <= value <= highest:
        return float(value)
    text = f"The argument {name} is {value!r}, must be a number from {lowest:g} to {highest:g}."
    raise DeviceError(text, argument=name, value=value, lowest=lowest, highest=highest)


def choice(arguments: Mapping[str, Any], name: str, known: Sequence[str]) -> Any:
    """One of the words in `known`.

    Raises:
        DeviceError: It is none of them.
    """
    value = arguments.get(name)
    if value in known:
        return value
    raise DeviceError(
        f"The argument {name} is {value!r}, must be one of {', '.join(known)}.", argument=name, value=value
    )


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
