"""Converts a state chart to a blueprint: regions become branches, nesting becomes levels, events become operations."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Iterator

from pcmrs.authoring.exchange import descriptors, plain
from pcmrs.authoring.exchange.importing._chart import Edge, Node
from pcmrs.authoring.exchange.importing._conditions import ConditionalEffects, TooManySituationsError
from pcmrs.authoring.exchange.importing._moves import Move, MoveGroup, Mover, grouped
from pcmrs.authoring.exchange.importing._reading import Findings, Names
from pcmrs.authoring.exchange.importing._regions import Region, regions_of
from pcmrs.authoring.exchange.importing._timers import TimerConversion
from pcmrs.fsm.blueprint import (
    Blueprint,
    BranchSpec,
    OperationSpec,
    ParentSpec,
    Requirement,
    RevocationSpec,
    TimerSpec,
)
from pcmrs.fsm.finding import Place

MAX_WORK = 1_000_000
"""Limit of events times states and transitions, which bounds the time of a conversion."""

MAX_REACTIONS = 20_000
"""Limit of situations in which any event has an effect."""

REINIT = "reinit"
"""Name of the re-initiation operation (RIO) of a branch."""

ROOT_NAME = "main"
"""Name of the workflow and of its outermost branch if the file has none."""


def blueprint_of(root: Node, findings: Findings) -> Blueprint | None:
    """Return the blueprint of a chart.

    Args:
        root: The chart; ids are unique and every target exists.
        findings: Collects what cannot be converted.

    Returns:
        The blueprint, or None if there are findings.
    """
    nodes = root.by_id()
    events: dict[str, Place] = {}
    edges = [edge for node in root.walk() for edge in node.edges]
    for edge in edges:
        for event in edge.events:
            events.setdefault(event, edge.place)
    if len(events) * (len(nodes) + len(edges)) > MAX_WORK:
        text = f"{len(nodes)} states with {len(edges)} transitions on {len(events)} events are too many."
        findings.add("too_large", text, root.place)
        return None
    blueprint = _Converter(root, nodes, findings).blueprint(events)
    return None if findings else blueprint


class _Converter:
    def __init__(self, root: Node, nodes: dict[str, Node], findings: Findings) -> None:
        self._root = root
        self._findings = findings
        self._roots = regions_of(root, nodes)
        self._regions = [region for outermost in self._roots for region in outermost.walk()]
        self._mover = Mover(self._regions, nodes, findings)
        self._conditions = ConditionalEffects(self._regions, nodes)
        self._edges: dict[str, list[Edge]] = defaultdict(list)
        for edge in (edge for node in root.walk() for edge in node.edges):
            for event in edge.events:
                self._edges[event].append(edge)
        self._names: dict[Node, str] = {}
        self._timers: dict[Region, dict[str, TimerSpec]] = {}
        self._reactions = 0
        self._counts: Counter[tuple[Region, str]] = Counter()
        self._operations: dict[Region, dict[str, OperationSpec]] = {region: {} for region in self._regions}
        self._operation_names = {
            r: Names(f"operations of {r.label.display_name or ROOT_NAME}", findings) for r in self._regions
        }

    def blueprint(self, events: dict[str, Place]) -> Blueprint:
        self._name_all()
        for event, place in events.items():
            self._add_event(event, place)
        timers = TimerConversion(self._root, self._regions, self._names, self._operations, self._findings)
        self._timers = {} if self._findings else timers.convert()
        branches = {region.name: self._branch(region) for region in self._regions}
        goal = {r.name: finals for r in self._roots if (finals := [self._names[s] for s in r.states if s.final])}
        name = plain(self._root.display_name) or ROOT_NAME
        return Blueprint(
            id=name,
            version="1.0.0",
            title=self._root.title,
            branches=branches,
            goal=goal,
            provenance=self._root.provenance,
        )

    def _name_all(self) -> None:
        branches = Names("branches", self._findings)
        for region in self._regions:
            region.name = branches.make(region.label.display_name or ROOT_NAME, region.label.place)
            states = Names(f"states of {region.label.display_name or ROOT_NAME}", self._findings, states=True)
            for state in region.states:
                self._names[state] = states.make(state.display_name, state.place, prefix=region.label.display_name)

    def _add_event(self, event: str, place: Place) -> None:
        moves: list[Move] = []
        edges = [edge for each in descriptors(event) for edge in self._edges[each]]
        for region in self._roots:
            try:
                found = [each for each in self._conditions.enabled_transitions(region, event, edges) if each.edges]
            except TooManySituationsError:
                self._findings.add("too_large", f"The event {event} has too many situations.", place)
                continue
            self._reactions += len(found)
            if self._reactions > MAX_REACTIONS:
                text = f"From {event} on, events have an effect in over {MAX_REACTIONS} situations."
                return self._findings.add("too_large", text, self._root.place)
            moves += [move for choice in found for move in self._mover.moves(choice.where, choice.edges)]
        domains = {region.name: [self._names[state] for state in region.states] for region in self._regions}
        for group in [] if self._findings else grouped(moves, domains, self._names):
            self._add_operation(event, group, place)

    def _add_operation(self, event: str, group: MoveGroup, place: Place) -> None:
        region = group.region
        base = plain(event, prefix=region.label.display_name)
        self._counts[region, event] += 1
        count = self._counts[region, event]
        name = base if count == 1 else f"{base}_{count}"
        to = {self._names[source]: self._names[target] for source, target in group.targets.items()}
        every = len(to) == len(region.states)
        self._operations[region][self._operation_names[region].take(name, event, place)] = OperationSpec(
            title=event,
            from_=["*"] if every else list(to),
            to=dict(to) if len(set(to.values())) > 1 else next(iter(to.values())),
            requires={branch: self._ordered(branch, states) for branch, states in group.requires.items()},
            sets={inner.name: self._names[goal] for inner, goal in group.sets},
        )

    def _ordered(self, branch: str, states: frozenset[str]) -> list[str]:
        region = next(region for region in self._regions if region.name == branch)
        return [self._names[state] for state in region.states if self._names[state] in states]

    def _branch(self, region: Region) -> BranchSpec:
        states = {self._names[state]: state.title or state.display_name for state in region.states}
        operations = {**self._operations[region], **dict(self._signals(region, list(states)))}
        if region.outer is None or region.home is None:
            timers = self._timers.get(region, {})
            return BranchSpec(title=region.label.title, states=states, operations=operations, timers=timers)
        start, home = next(iter(states)), self._names[region.home]
        around = {outer.name: [self._names[state]] for outer, state in region.chain()}
        title = self._reinit_event(region, operations.get(REINIT), around)
        if not title:
            self._operation_names[region].take(REINIT, REINIT, region.label.place)
        operations[REINIT] = OperationSpec(title=title, from_=["*"], to=start, rio=True, requires=around)
        anywhere = [self._names[state] for state in region.outer.states]
        compatible = {state: anywhere if state == start else [home] for state in states}
        return BranchSpec(
            level=1 + len(around),
            title=region.label.title,
            states=states,
            operations=operations,
            parent=ParentSpec(branch=region.outer.name, start=home, compatible=compatible),
            emits=dict.fromkeys(states, f"{region.name}_changed"),
            timers=self._timers.get(region, {}),
            revocations=self._revocations(region, region.outer),
        )

    def _reinit_event(self, region: Region, found: OperationSpec | None, around: Requirement) -> str:
        """Return the event that re-initiates a region already, as one in an export does; empty if there is none."""
        if found is None or found.sets or not found.requires.items() <= around.items():
            return ""
        start, *others = (self._names[state] for state in region.states)
        return found.title if found.to == start and found.from_ in (["*"], others) else ""

    def _signals(self, region: Region, states: list[str]) -> Iterator[tuple[str, OperationSpec]]:
        """Return the operations that each branch inside calls when it changes (Rule 2); they have no effect."""
        # Rule 2 demands a signal, but the chart has no effect for it: it keeps every state.
        keep = states[0] if len(states) == 1 else {state: state for state in states}
        for inner in region.inner:
            name = f"{inner.name}_changed"
            self._operation_names[region].take(name, name, inner.label.place)
            yield name, OperationSpec(from_=["*"], to=keep, iio=True)

    def _revocations(self, region: Region, outer: Region) -> list[RevocationSpec]:
        """Return the revocations of a region by changes further out, also if the parent keeps its state.

        Such a change takes the parent to its start or sets it. A parent that was there already does not change, and
        Rule 3 re-initiates the region only with a change: so this is needed where the parent's start, or a state that
        an operation sets it to, is the one that the region refines.
        """
        further = [around.name for around, _ in list(region.chain())[1:]]
        start, *others = (self._names[state] for state in region.states)
        if not further or not others or not self._may_be_kept(outer, region.home):
            return []
        return [RevocationSpec(by=further, from_=others, to=start)]

    def _may_be_kept(self, region: Region, state: Node | None) -> bool:
        """Return true if a change further out may enter a state of the region that is active already."""
        operations = (operation for taken in self._operations.values() for operation in taken.values())
        set_to = (operation.sets.get(region.name) for operation in operations)
        return state is not None and (state is region.states[0] or self._names[state] in set_to)
