"""Injectable faults, the cell as they change it, and checks of their arguments.

Arguments come as words of a line or as data from the bus.
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
    """Return a truth value; true if the argument is missing.

    Args:
        arguments: Arguments of a fault by name.
        name: Name of the argument.

    Raises:
        DeviceError: The argument is not a truth value.
    """
    value = arguments.get(name, True)
    if isinstance(value, bool):
        return value
    raise DeviceError(f"The argument {name} is {value!r}, must be on or off.", argument=name, value=value)


def number(arguments: Mapping[str, Any], name: str, lowest: float, highest: float) -> float:
    """Return a number within a range.

    Args:
        arguments: Arguments of a fault by name.
        name: Name of the argument.
        lowest: Smallest allowed number, in the argument's unit.
        highest: Largest allowed number, in the argument's unit.

    Raises:
        DeviceError: The argument is missing, not a number, or out of range.
    """
    value = arguments.get(name)
    if isinstance(value, int | float) and not isinstance(value, bool) and lowest <= value <= highest:
        return float(value)
    text = f"The argument {name} is {value!r}, must be a number from {lowest:g} to {highest:g}."
    raise DeviceError(text, argument=name, value=value, lowest=lowest, highest=highest)


def choice(arguments: Mapping[str, Any], name: str, known: Sequence[str]) -> Any:
    """Return one of some known words.

    Args:
        arguments: Arguments of a fault by name.
        name: Name of the argument.
        known: Allowed words.

    Raises:
        DeviceError: The argument is missing or not among the words.
    """
    value = arguments.get(name)
    if value in known:
        return value
    raise DeviceError(
        f"The argument {name} is {value!r}, must be one of {', '.join(known)}.", argument=name, value=value
    )


class FaultTarget(Protocol):
    """The cell as faults change it.

    Attributes:
        facts: Geometry and limits of the arm.
        world: True state of the cell.
        tracker: The tracker, with its present faults.
    """

    facts: ArmFacts
    world: World
    tracker: SimTracker

    @property
    def robot_faults(self) -> RobotFaults:
        """Present faults of the robot."""

    def cut_robot(self, cut: bool) -> None:
        """Cut the robot's link, or restore it."""


@dataclass(frozen=True)
class Fault:
    """One fault of the catalogue that can be injected into a simulated cell, and ended.

    Attributes:
        name: Name of the fault.
        row: Row of the fault catalogue, such as ``S5``.
        help: Effect of the fault, in one line.
        arguments: Names of its arguments, in the order of a line of text.
        apply: Injects or ends the fault in a cell; raises `DeviceError` for a wrong argument.
        also: Other rows of the catalogue that this fault covers.
    """

    name: str
    row: str
    help: str
    arguments: tuple[str, ...]
    apply: Callable[[FaultTarget, Mapping[str, Any]], None]
    also: tuple[str, ...] = ()

    @property
    def rows(self) -> tuple[str, ...]:
        """All rows of the catalogue that this fault covers."""
        return (self.row, *self.also)
