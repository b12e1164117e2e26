"""The regions of a state chart: sets of states of which one is active. Each becomes a branch."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field

from pcmrs.authoring.exchange import descriptors
from pcmrs.authoring.exchange.importing._chart import Edge, Node


@dataclass(slots=True, eq=False)
class Region:
    """States of which exactly one is active while `home` is.

    Attributes:
        label: The state that the region is named after: the one around it, or a child of a parallel state.
        states: Its states, the start first.
        outer: The region of the state it refines; None for a root.
        home: That state.
        name: The branch's name.
    """

    label: Node
    states: list[Node]
    outer: Region | None = None
    home: Node | None = None
    name: str = ""
    inner: list[Region] = field(default_factory=list)

    def inside(self, state: Node) -> list[Region]:
        """Return the regions that refine one of its states, in the order of the file."""
        return [region for region in self.inner if region.home is state]

    def walk(self) -> Iterator[Region]:
        """Return this region and all regions inside."""
        yield self
        for region in self.inner:
            yield from region.walk()

    def chain(self) -> Iterator[tuple[Region, Node]]:
        """Return the regions and states that must be active for it to be active, innermost first."""
        region = self
        while region.outer is not None and region.home is not None:
            yield region.outer, region.home
            region = region.outer

    def state_around(self, node: Node) -> Node | None:
        """Return the state of this region that `node` is, or is inside of."""
        return next((state for state in (node, *node.outward()) if state in self.states), None)


def regions_of(root: Node, nodes: dict[str, Node]) -> list[Region]:
    """Return the outermost regions of a chart, with those inside.

    A region whose only state is a mere frame around others is left out: it never changes.

    Args:
        root: The chart.
        nodes: All states by id.
    """
    whole = Region(root, _start_first(root))
    _refine(whole)
    return _without_frame(whole, {id(domain) for domain in _domains(root, nodes)})


def domain_of(edge: Edge, nodes: dict[str, Node]) -> Node:
    """Return the innermost state with one active child that a transition does not leave: its children change.

    A transition from a compound state into itself is a change inside of that state, which it would only leave to
    enter it again. If leaving it would also leave other regions, the state around them is returned, unless
    the transition is internal.

    Args:
        edge: The transition.
        nodes: All states by id.
    """
    ends = [nodes[target] for target in edge.targets]
    source, around = edge.source, edge.source.above
    if source.compound and all(source in end.outward() for end in ends) and (edge.internal or not _is_region(source)):
        return source
    while around is not None and not (around.compound and all(around in end.outward() for end in ends)):
        around = around.above
    return around if around is not None else source


def _is_region(node: Node) -> bool:
    return node.above is None or node.above.parallel


def _domains(root: Node, nodes: dict[str, Node]) -> Iterator[Node]:
    """Return the states whose children change by a transition, or by several regions moving on one event."""
    for node in root.walk():
        yield from (domain_of(edge, nodes) for edge in node.edges if edge.targets)
        if node.parallel and _shared(node):
            yield node if node.above is None or node.above.parallel else node.above


def _shared(parallel: Node) -> bool:
    """Return true if two regions may react to the same event."""
    seen: set[str] = set()
    beginnings: set[str] = set()
    for child in parallel.children:
        events = {event for node in child.walk() for edge in node.edges for event in edge.events}
        prefixes = {beginning for event in events for beginning in descriptors(event)}
        if events & beginnings or prefixes & seen:
            return True
        seen |= events
        beginnings |= prefixes
    return False


def _start_first(node: Node) -> list[Node]:
    return sorted(node.children, key=lambda child: child.id != node.initial) if node.initial else list(node.children)


def _refine(region: Region) -> None:
    """Add the regions inside the states of a region."""
    for state in region.states:
        if state.parallel:
            made = [Region(c, _start_first(c) if c.compound else [c], region, state) for c in state.children]
        else:
            made = [Region(state, _start_first(state), region, state)] if state.children else []
        region.inner += made
    for inner in region.inner:
        _refine(inner)


def _without_frame(region: Region, needed: set[int]) -> list[Region]:
    """Return the region itself or, if it is a mere frame, those inside it."""
    nested = [deeper for inner in region.inner for deeper in _without_frame(inner, needed)]
    only = region.states[0]
    reacts = (only.parallel and only.edges) or (_is_region(region.label) and region.label.edges)
    if len(region.states) == 1 and nested and not reacts and id(region.label) not in needed:
        for inner in nested:
            inner.outer, inner.home = region.outer, region.home
        return nested
    region.inner = nested
    return [region]
