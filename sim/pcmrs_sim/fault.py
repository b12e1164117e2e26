"""What an injectable fault is."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from pcmrs_sim.cell import Cell


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
    apply: Callable[[Cell, Mapping[str, Any]], None]
    also: tuple[str, ...] = ()

    @property
    def rows(self) -> tuple[str, ...]:
        """All rows of the catalogue that it brings about."""
        return (self.row, *self.also)
