"""Conditions on active states, as an export writes them: ``In('a') && (In('b') || In('c'))``.

Also the effects of an event in each situation of a state chart, by the priorities of SCXML.
"""

from __future__ import annotations

import itertools
import math
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass

from pcmrs.authoring.exchange.importing._chart import ActiveGroups, Edge, Node
from pcmrs.authoring.exchange.importing._regions import Region

MAX_WORK = 1_000_000
"""Limit of the situations of all events together, times the states and conditions examined in each."""

IN = re.compile(r"\s*In\(\s*(?:'([^'\\]+)'|\"([^\"\\]+)\")\s*\)\s*")


def read_condition(text: str) -> ActiveGroups | None:
    """Return the groups of states of a condition, or None if it has any other form."""
    parts = text.split("&&")
    groups = [_group(part.strip(), alone=len(parts) == 1) for part in parts]
    return None if None in groups else tuple(group for group in groups if group)


def _group(text: str, *, alone: bool) -> tuple[str, ...] | None:
    enclosed = text.startswith("(") and text.endswith(")")
    found = [IN.fullmatch(part) for part in (text[1:-1] if enclosed else text).split("||")]
    if None in found or (len(found) > 1 and not (alone or enclosed)):
        return None
    return tuple(match[1] or match[2] for match in found if match)


class ConditionalEffects:
    """Effects of events whose transitions depend on the states of other regions.

    Args:
        regions: All regions.
        nodes: All states by id.
    """

    def __init__(self, regions: Sequence[Region], nodes: Mapping[str, Node]) -> None:
        self._regions = {state: region for region in regions for state in region.states}
        self._nodes = nodes
        self._work = 0

    def enabled_transitions(self, region: Region, event: str, edges: Sequence[Edge]) -> list[EnabledTransitions]:
        """Return the enabled transitions of a region in each situation of the other regions that `edges` depend on.

        Args:
            region: The region.
            event: The event.
            edges: Its transitions.

        Raises:
            TooManySituationsError: There are too many.
        """
        found: list[EnabledTransitions] = []
        for elsewhere in self._situations(edges):
            for choice in enabled_transitions(region, lambda node, now=elsewhere: self._first(node, event, now)):  # type: ignore[misc]
                if all(elsewhere.get(each, state) is state for each, state in choice.where.items()):
                    found.append(EnabledTransitions(elsewhere | choice.where, choice.edges))
            if len(found) > MAX_SITUATIONS:
                raise TooManySituationsError
        return found

    def _situations(self, edges: Sequence[Edge]) -> Iterator[Situation]:
        named = {name for edge in edges for group in edge.condition for name in group}
        regions = list(dict.fromkeys(region for name in sorted(named) for region in self._needed(name)))
        number = math.prod(len(region.states) for region in regions)
        self._work += number * (len(self._nodes) + sum(len(group) for edge in edges for group in edge.condition))
        # Counted before they are enumerated: a small file can have very many of them.
        if number > MAX_SITUATIONS or (regions and self._work > MAX_WORK):
            raise TooManySituationsError
        for states in itertools.product(*(region.states for region in regions)):
            yield dict(zip(regions, states, strict=True))

    def _first(self, node: Node, event: str, now: Situation) -> Edge | None:
        return next((edge for edge in node.edges_on(event) if self._holds(edge.condition, now)), None)

    def _holds(self, condition: ActiveGroups, now: Situation) -> bool:
        return all(any(self._active(name, now) for name in group) for group in condition)

    def _active(self, name: str, now: Situation) -> bool:
        return all(now[region] is state for region, state in self._needed(name).items())

    def _needed(self, name: str) -> Situation:
        """Return the regions that must be in a certain state for the named one to be active; none if it always is."""
        node = self._nodes[name]
        return {self._regions[each]: each for each in (node, *node.outward()) if each in self._regions}


MAX_SITUATIONS = 2_000
"""Limit for one event; beyond it the operations made from the event could not be reviewed."""

Situation = dict[Region, Node]
"""Regions to their active states; other regions do not matter."""


class TooManySituationsError(Exception):
    """An event has more situations than `MAX_SITUATIONS`."""


@dataclass(frozen=True, slots=True)
class EnabledTransitions:
    """The transitions that an event triggers in one situation; those without target consume the event."""

    where: Situation
    edges: tuple[Edge, ...]


First = Callable[[Node], Edge | None]
"""The first transition of a state, not of those around it, that an event triggers."""


def enabled_transitions(region: Region, first: First) -> list[EnabledTransitions]:
    """Return every situation of a region and the regions inside in which an event finds different transitions.

    Inner transitions come before those of the states around them, the first in the file before the next.

    Args:
        region: The region.
        first: Returns the first transition that the event triggers in a state.

    Raises:
        TooManySituationsError: There are too many.
    """
    found = [
        EnabledTransitions({region: state} | choice.where, choice.edges)
        for state in region.states
        for choice in _of_state(region, state, first)
    ]
    if len(found) > MAX_SITUATIONS:
        raise TooManySituationsError
    is_state = region.label is region.home or region.label in region.states
    own = None if is_state else first(region.label)
    return [EnabledTransitions(c.where, c.edges or ((own,) if own else ())) for c in found]


def _of_state(region: Region, state: Node, first: First) -> Iterator[EnabledTransitions]:
    own = first(state)
    inner = [_quiet_or(enabled_transitions(within, first)) for within in region.inside(state)]
    for number, combination in enumerate(itertools.product(*inner)):
        if number > MAX_SITUATIONS:
            raise TooManySituationsError
        where = {k: v for choice in combination for k, v in choice.where.items()}
        taken = tuple(edge for choice in combination for edge in choice.edges)
        passed = not combination or any(not choice.edges for choice in combination)
        moving = any(edge.targets for edge in taken)
        passing = (own,) if own else ()
        yield EnabledTransitions(where, passing if passed and not moving else taken)


def _quiet_or(found: list[EnabledTransitions]) -> list[EnabledTransitions]:
    """Return one situation for all of them if the event finds nothing in any."""
    return found if any(choice.edges for choice in found) else [EnabledTransitions({}, ())]
