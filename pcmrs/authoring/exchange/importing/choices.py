"""What an event does in each situation of a state chart, by the priorities of SCXML."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator
from dataclasses import dataclass

from pcmrs.authoring.exchange.importing.chart import Edge, Node
from pcmrs.authoring.exchange.importing.regions import Region

MAX_SITUATIONS = 2_000
"""Of one event; beyond this the operations made from it could not be reviewed."""

Situation = dict[Region, Node]
"""Regions to their active states; regions it does not name do not matter."""


class TooManyError(Exception):
    """An event has more situations than `MAX_SITUATIONS`."""


@dataclass(frozen=True, slots=True)
class Choice:
    """The transitions an event triggers in one situation; those without target use the event up."""

    where: Situation
    edges: tuple[Edge, ...]


First = Callable[[Node], Edge | None]
"""The first transition of a state, not of those around it, that an event triggers."""


def choices(region: Region, first: First) -> list[Choice]:
    """Every situation of a region and the regions inside in which an event finds different transitions.

    Inner transitions come before those of the states around them, the first in the file before the next.

    Raises:
        TooManyError: There are too many.
    """
    found = [
        Choice({region: state} | choice.where, choice.edges)
        for state in region.states
        for choice in _of_state(region, state, first)
    ]
    if len(found) > MAX_SITUATIONS:
        raise TooManyError
    is_state = region.label is region.home or region.label in region.states
    own = None if is_state else first(region.label)
    return [Choice(c.where, c.edges or ((own,) if own else ())) for c in found]


def _of_state(region: Region, state: Node, first: First) -> Iterator[Choice]:
    own = first(state)
    inner = [_quiet_or(choices(within, first)) for within in region.inside(state)]
    for number, combination in enumerate(itertools.product(*inner)):
        if number > MAX_SITUATIONS:
            raise TooManyError
        where = {k: v for choice in combination for k, v in choice.where.items()}
        taken = tuple(edge for choice in combination for edge in choice.edges)
        passed = not combination or any(not choice.edges for choice in combination)
        moving = any(edge.targets for edge in taken)
        passing = (own,) if own else ()
        yield Choice(where, passing if passed and not moving else taken)


def _quiet_or(found: list[Choice]) -> list[Choice]:
    """All situations as one where the event finds nothing in any of them."""
    return found if any(choice.edges for choice in found) else [Choice({}, ())]
