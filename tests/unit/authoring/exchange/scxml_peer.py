"""python-statemachine, which executes SCXML, as a peer of the engine."""

from __future__ import annotations

from collections.abc import Mapping
from random import Random

from statemachine.io.scxml.processor import SCXMLProcessor

from pcmrs.authoring.exchange.exporting._events import OperationEnding, commands
from pcmrs.authoring.exchange.exporting._nesting import Nesting, nesting_of
from pcmrs.authoring.exchange.exporting.scxml import scxml
from pcmrs.fsm import Blueprint
from pcmrs.fsm.closure import Denial
from pcmrs.fsm.engine import Engine


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


def perform(engine: Engine, command: OperationEnding) -> bool:
    """Whether the engine accepts the command, and can end it so."""
    closure = engine.ask(command.branch, command.operation)
    known = ("failed", "unknown")
    if isinstance(closure, Denial) or (command.ending not in known and command.ending not in closure.outcomes):
        return False
    engine.perform(command.branch, command.operation, command.ending)
    return True


def trace(blueprint: Blueprint, rng: Random, length: int) -> int:
    """Walks both; returns how many commands were accepted."""
    engine, peer, nesting = Engine(blueprint), Peer(scxml(blueprint)), nesting_of(blueprint)
    accepted = 0
    possible = list(commands(blueprint))
    assert peer.configuration() == expected(blueprint, nesting, engine.joint())
    for _ in range(length if possible else 0):
        command = rng.choice(possible)
        before = engine.joint()
        done = perform(engine, command)
        if not fits(blueprint, engine.joint()):
            break  # unsound, and the verifier says so; an equivalent chart is promised for sound workflows
        peer.send(command.event)
        assert peer.configuration() == expected(blueprint, nesting, engine.joint()), (command.event, before)
        accepted += done
    return accepted
