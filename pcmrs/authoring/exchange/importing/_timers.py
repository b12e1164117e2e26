"""Converts the delayed events of a state chart to timers of the branches."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import msgspec

from pcmrs.authoring.exchange.importing._chart import DelayedEvent, Edge, Node, Restart
from pcmrs.authoring.exchange.importing._reading import Findings, Names
from pcmrs.authoring.exchange.importing._regions import Region
from pcmrs.fsm.blueprint import OperationSpec, TimerSpec
from pcmrs.fsm.finding import Place


class TimerConversion:
    """Make timers of delayed events; the operations that they post become events.

    Args:
        root: The chart.
        regions: All regions.
        names: State to its name in the blueprint.
        operations: Operations of each region; those that a timer posts are marked as events in place.
        findings: Collects what cannot be converted.
    """

    def __init__(
        self,
        root: Node,
        regions: Sequence[Region],
        names: Mapping[Node, str],
        operations: Mapping[Region, dict[str, OperationSpec]],
        findings: Findings,
    ) -> None:
        self._root = root
        self._names = names
        self._operations = operations
        self._findings = findings
        self._home = {state: region for region in regions for state in region.states}
        self._taken = {region: Names(f"timers of {region.name}", findings) for region in regions}
        self._timers: dict[Region, dict[str, TimerSpec]] = {region: {} for region in regions}
        self._made: dict[str, tuple[Region, str, DelayedEvent]] = {}
        self._senders: dict[str, list[str]] = {}

    def convert(self) -> dict[Region, dict[str, TimerSpec]]:
        """Return the timers of each region."""
        for node in self._root.walk():
            for delayed in node.delayed:
                self._add(node, delayed)
        for node in self._root.walk():
            for edge in node.edges:
                for restart in edge.restarts:
                    self._restart(edge, restart)
        return self._timers

    def _add(self, node: Node, delayed: DelayedEvent) -> None:
        region = self._home.get(node)
        if region is None:
            self._refuse(f"{node.display_name} is always active: its delayed event would never begin", delayed.place)
            return
        posted = self._posted(region, delayed.event, self._names[node])
        if posted is None:
            text = f"The delayed event {delayed.event} has not exactly one effect in {node.display_name}"
            self._refuse(text, delayed.place)
            return
        operations = self._operations[region]
        operations[posted] = msgspec.structs.replace(operations[posted], event=True)
        if delayed.id not in self._made:
            name = self._taken[region].make(delayed.id, delayed.place, prefix=region.name)
            self._made[delayed.id] = region, name, delayed
            self._timers[region][name] = TimerSpec(states=[], after_s=delayed.seconds, posts=posted)
        earlier, name, first = self._made[delayed.id]
        timer = self._timers[earlier][name]
        if earlier is not region or not _is_same(first, delayed) or timer.posts != posted:
            text = f"The delayed event {delayed.id} is sent with another time or effect elsewhere"
            self._refuse(text, delayed.place)
            return
        self._senders.setdefault(delayed.id, []).append(node.id)
        self._timers[region][name] = msgspec.structs.replace(timer, states=[*timer.states, self._names[node]])

    def _restart(self, edge: Edge, restart: Restart) -> None:
        delayed, source = restart.delayed, edge.source
        region, name, first = self._made.get(delayed.id, (None, "", delayed))
        senders = self._senders.get(delayed.id, [])
        kept = source.id in senders and not edge.targets
        fits = sorted(restart.states) == sorted(senders) if restart.states else kept
        home = self._home.get(source)
        if region is None or home is None or not fits or not _is_same(first, delayed):
            text = f"The delayed event {delayed.id} may be sent again only while the states that send it are active"
            self._refuse(text, delayed.place)
            return
        for event in edge.events:
            operation = self._posted(home, event, self._names[source])
            if operation is None:
                self._refuse(f"The event {event} has not exactly one effect in {source.display_name}", edge.place)
                continue
            timer = self._timers[region][name]
            if home is region and operation == timer.posts:
                timer = msgspec.structs.replace(timer, repeat=True)
            elif f"{home.name}.{operation}" not in timer.restarted_by:
                timer = msgspec.structs.replace(timer, restarted_by=[*timer.restarted_by, f"{home.name}.{operation}"])
            self._timers[region][name] = timer

    def _posted(self, region: Region, event: str, state: str) -> str | None:
        """Return the only operation of a region that is made from an event and valid in a state; None without one."""
        found = [
            name
            for name, each in self._operations[region].items()
            if each.title == event and (state in each.from_ or each.from_ == ["*"])
        ]
        return found[0] if len(found) == 1 else None

    def _refuse(self, text: str, place: Place) -> None:
        self._findings.add("not_supported", f"{text}: not supported.", place)


def _is_same(one: DelayedEvent, other: DelayedEvent) -> bool:
    return replace(one, place=other.place) == other
