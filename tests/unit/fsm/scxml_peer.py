"""python-statemachine, which executes SCXML, as a peer of the engine."""

from __future__ import annotations

from collections.abc import Mapping

from statemachine.io.scxml.processor import SCXMLProcessor

from pcmrs.authoring.exchange.exporting.nesting import Nesting
from pcmrs.fsm import Blueprint


class Peer:
    """A running chart."""

    def __init__(self, document: str) -> None:
        processor = SCXMLProcessor()
        processor.parse_scxml("chart", document)
        self._machine = processor.start()  # type: ignore[no-untyped-call]

    def configuration(self) -> set[str]:
        """Ids of all active atomic states."""
        return {state.id for state in self._machine.configuration if not state.states}

    def active(self) -> set[str]:
        """Ids of all active states."""
        return {state.id for state in self._machine.configuration}

    def send(self, event: str) -> None:
        """Lets the chart react; an event that nothing reacts to is none."""
        self._machine.send(event)


def expected(blueprint: Blueprint, nesting: Nesting, joint: Mapping[str, str]) -> set[str]:
    """The atomic states that the exported chart must be in."""
    active = {branch for branch in blueprint.branches if nesting.active(branch, joint)}
    return {f"{b}.{joint[b]}" for b in active if not nesting.inside(b, joint[b])}


def fits(blueprint: Blueprint, joint: Mapping[str, str]) -> bool:
    """Whether every child fits its parent."""
    parents = {name: spec.parent for name, spec in blueprint.branches.items()}
    return all(p is None or joint[p.branch] in p.compatible[joint[name]] for name, p in parents.items())
