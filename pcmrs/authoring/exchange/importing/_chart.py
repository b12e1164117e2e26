"""A state chart as other tools know it: nested and parallel states and the effects of events. All readers make one."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field

from msgspec import UNSET, UnsetType

from pcmrs.authoring.exchange import descriptors
from pcmrs.fsm.blueprint import ProvenanceSpec
from pcmrs.fsm.finding import Place

ActiveGroups = tuple[tuple[str, ...], ...]
"""Groups of state ids; at least one state of each group must be active."""


@dataclass(frozen=True, slots=True)
class DelayedEvent:
    """An event that a state sends to the chart some time after it is entered, unless it is left before.

    Attributes:
        id: Name by which it is cancelled.
        event: The event.
        seconds: The time, s.
        place: Its place in the file.
    """

    id: str
    event: str
    seconds: float
    place: Place


@dataclass(frozen=True, slots=True)
class Restart:
    """A delayed event that a transition cancels and sends again.

    Attributes:
        delayed: The event.
        states: Ids of the states of which one must be active; empty if that is the source of the transition.
    """

    delayed: DelayedEvent
    states: tuple[str, ...] = ()


@dataclass(slots=True, eq=False)
class Edge:
    """A transition; without targets it consumes the event and keeps the state.

    Attributes:
        source: The state it leaves.
        events: Any of them triggers it.
        targets: Ids of the states it goes to.
        place: Its place in the file.
        internal: It does not leave its source when its targets are inside.
        condition: Condition for taking it: one state of each group must be active.
        restarts: Delayed events that it sends again.
    """

    source: Node
    events: list[str]
    targets: list[str]
    place: Place
    internal: bool = False
    condition: ActiveGroups = ()
    restarts: list[Restart] = field(default_factory=list)


@dataclass(slots=True, eq=False)
class Node:
    """A state.

    Attributes:
        id: Unique in the chart.
        place: Its place in the file.
        name: Its name, if that is not its id; need not be unique.
        title: Its meaning, if the file says more than the name.
        parallel: All of its children are active together.
        final: Nothing leaves it.
        initial: Id of the child it starts in; empty for the first.
        above: The state it is in; None for the root.
        children: States in it.
        edges: Transitions out of it, first match first.
        delayed: Events that it sends some time after it is entered.
        provenance: Of the root: how a language model has drafted the workflow.
    """

    id: str
    place: Place
    name: str = ""
    title: str = ""
    parallel: bool = False
    final: bool = False
    initial: str = ""
    above: Node | None = None
    children: list[Node] = field(default_factory=list)
    edges: list[Edge] = field(default_factory=list)
    delayed: list[DelayedEvent] = field(default_factory=list)
    provenance: ProvenanceSpec | UnsetType = UNSET

    @property
    def display_name(self) -> str:
        """Its name for people."""
        return self.name or self.id

    @property
    def compound(self) -> bool:
        """Exactly one of its children is active with it."""
        return bool(self.children) and not self.parallel

    def walk(self) -> Iterator[Node]:
        """Return this state and all states in it, in the order of the file."""
        yield self
        for child in self.children:
            yield from child.walk()

    def inside(self) -> Iterator[Node]:
        """Return all states in it, in the order of the file."""
        return (node for node in self.walk() if node is not self)

    def by_id(self) -> dict[str, Node]:
        """Return all states in it; of two with the same id, the last."""
        return {node.id: node for node in self.inside()}

    def outward(self) -> Iterator[Node]:
        """Return the states that it is in, innermost first, the root last."""
        node = self.above
        while node is not None:
            yield node
            node = node.above

    def add(self, child: Node) -> Node:
        """Add a state to it, and return that state."""
        child.above = self
        self.children.append(child)
        return child

    def edges_on(self, event: str) -> list[Edge]:
        """Return its own transitions, not those of the states around it, that an event may trigger."""
        matching = set(descriptors(event))
        return [edge for edge in self.edges if matching.intersection(edge.events)]
