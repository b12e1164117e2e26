"""The operations that a chart's events become.

One event may become several operations, ``<event>``, ``<event>_2`` and so on, of which at most one is accepted in
any situation; the title of each is the event. An event that moves several regions at once becomes an operation
of the branch around them that sets their states.
"""

from __future__ import annotations

import itertools
from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

from pcmrs.authoring.exchange._cubes import Cube, merge
from pcmrs.authoring.exchange.importing._chart import Edge, Node
from pcmrs.authoring.exchange.importing._conditions import Situation
from pcmrs.authoring.exchange.importing._reading import Findings
from pcmrs.authoring.exchange.importing._regions import Region, domain_of

Sets = tuple[tuple[Region, Node], ...]


@dataclass(frozen=True, slots=True)
class Move:
    """Effect of an event in one situation: a region changes its state, and sets regions inside that state."""

    region: Region
    source: Node
    target: Node
    sets: Sets
    where: Situation


@dataclass(slots=True)
class MoveGroup:
    """Moves of one region that one operation can make."""

    region: Region
    sets: Sets
    requires: Cube
    targets: dict[Node, Node] = field(default_factory=dict)


class Mover:
    """Converter of transitions to moves that reports those that cannot be converted.

    Args:
        regions: All regions.
        nodes: All states by id.
        findings: Collects unsupported elements.
    """

    def __init__(self, regions: Sequence[Region], nodes: dict[str, Node], findings: Findings) -> None:
        self._by_label = {region.label: region for region in regions}
        self._nodes = nodes
        self._findings = findings

    def moves(self, where: Situation, edges: Sequence[Edge]) -> list[Move]:
        """Return the joint effect of the transitions; empty if there is none or it is not supported.

        Args:
            where: The situation.
            edges: The transitions that an event triggers in it.
        """
        moving = [edge for edge in edges if edge.targets]
        if not moving:
            return self._stay(where, edges[0])
        return self._together(where, moving) if len(moving) > 1 else self._alone(where, moving[0])

    def _stay(self, where: Situation, edge: Edge) -> list[Move]:
        staying = (region for region, state in where.items() if state is edge.source and not state.children)
        return [Move(region, edge.source, edge.source, (), where) for region in staying]

    def _alone(self, where: Situation, edge: Edge) -> list[Move]:
        region = self._by_label[domain_of(edge, self._nodes)]
        target = region.state_around(self._nodes[edge.targets[0]])
        found: list[Move] = []
        for source in [where[region]] if region in where else region.states:
            if target is not None and (sets := self._sets(region, source, target, edge)) is not None:
                found.append(Move(region, source, target, sets, {**where, region: source}))
        return found

    def _sets(self, region: Region, source: Node, target: Node, edge: Edge) -> Sets | None:
        """Return the states to set in regions inside the target, if they would not go there by themselves."""
        sets: list[tuple[Region, Node]] = []
        ends = [self._nodes[name] for name in edge.targets]
        for inner in region.inside(target):
            named = [state for end in ends if (state := inner.state_around(end)) is not None]
            goal = named[0] if named else inner.states[0]
            if len(set(map(id, named))) > 1 or not self._default_below(inner, goal, ends):
                self._refuse(edge, "A target lies deeper than one level below the change")
                return None
            if source is target or goal is not inner.states[0]:
                sets.append((inner, goal))
        return tuple(sets)

    def _default_below(self, region: Region, state: Node, ends: list[Node]) -> bool:
        """Return true if these targets enter everything inside a state at its start."""
        for inner in region.inside(state):
            named = {s for end in ends if (s := inner.state_around(end)) is not None}
            if named - {inner.states[0]} or not self._default_below(inner, inner.states[0], ends):
                return False
        return True

    def _together(self, where: Situation, edges: list[Edge]) -> list[Move]:
        """Return one move of the region around those that move, which sets their states."""
        # In a chart, regions move independently on one event; in a blueprint, an operation around them must move all.
        domains = [self._by_label[domain_of(edge, self._nodes)] for edge in edges]
        outer, home = domains[0].outer, domains[0].home
        event = " ".join(edges[0].events)
        if outer is None or home is None or any((d.outer, d.home) != (outer, home) for d in domains):
            return self._refuse(edges[0], f"{event} moves states here and elsewhere that are not next to each other")
        if len(set(domains)) < len(domains):
            return self._refuse(edges[0], f"{event} leaves the same state here and elsewhere in two ways")
        if any(region.inner for region in outer.inside(home) if region not in domains):
            return self._refuse(edges[0], f"{event} moves several regions beside one that has inner states")
        combinations = list(itertools.product(*(self._alone(where, edge) for edge in edges)))
        for move in itertools.chain(*combinations):
            if any(goal is not inner.states[0] for inner, goal in move.sets):
                return self._refuse(edges[0], f"{event} enters an inner state that is not initial, and moves others")
        return [
            Move(
                outer,
                home,
                home,
                tuple((move.region, move.target) for move in moves),
                {outer: home} | {region: state for move in moves for region, state in move.where.items()},
            )
            for moves in combinations
        ]

    def _refuse(self, edge: Edge, text: str) -> list[Move]:
        self._findings.add("not_supported", f"{text}: not supported.", edge.place)
        return []


def grouped(moves: list[Move], domains: dict[str, list[str]], names: dict[Node, str]) -> list[MoveGroup]:
    """Return the fewest operations that make the same moves.

    Args:
        moves: The moves.
        domains: Region's branch to all its states.
        names: Names of the states.
    """
    cubes: dict[tuple[Region, Node, Node, Sets], list[Cube]] = defaultdict(list)
    for move in moves:
        cube = {r.name: frozenset({names[s]}) for r, s in move.where.items() if r is not move.region}
        cubes[move.region, move.source, move.target, move.sets].append(cube)
    groups: list[MoveGroup] = []
    for region, source, target, sets, cube in _merged(cubes, domains):
        same = [group for group in groups if (group.region, group.sets, group.requires) == (region, sets, cube)]
        group = next((group for group in same if source not in group.targets), None)
        if group is None:
            groups.append(group := MoveGroup(region, sets, cube))
        group.targets[source] = target
    return groups


def _merged(
    cubes: dict[tuple[Region, Node, Node, Sets], list[Cube]], domains: dict[str, list[str]]
) -> Iterator[tuple[Region, Node, Node, Sets, Cube]]:
    for (region, source, target, sets), parts in cubes.items():
        for cube in merge(parts, domains):
            yield region, source, target, sets, cube
