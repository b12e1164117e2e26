"""The engine and another implementation of state charts take the same path through any workflow."""

from __future__ import annotations

from pathlib import Path
from random import Random
from typing import Any

import pytest
from random_blueprints import random_blueprint
from scxml_peer import Peer, expected, fits

from pcmrs.fsm import Blueprint, load_blueprint
from pcmrs.fsm.closure import Denial
from pcmrs.fsm.engine import Engine
from pcmrs.fsm.exchange.nested import nesting_of
from pcmrs.fsm.exchange.reactions import Command, commands
from pcmrs.fsm.exchange.scxml import scxml

RATMS = load_blueprint(Path("pcmrs/workflows/ratms.toml"))


def perform(engine: Engine, command: Command) -> bool:
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


def walk(seeds: range) -> None:
    accepted = [trace(random_blueprint(Random(seed)), Random(seed), 25) for seed in seeds]
    assert sum(count > 3 for count in accepted) > len(seeds) // 2, "too few traces went anywhere"


def test_random_workflows() -> None:
    walk(range(200))


@pytest.mark.nightly
@pytest.mark.timeout(3600)
def test_many_random_workflows() -> None:
    walk(range(1_000, 11_000))


@pytest.mark.parametrize("seed", range(5))
def test_ratms(seed: int) -> None:
    assert trace(RATMS, Random(seed), 400) > 40


@pytest.mark.parametrize("name", sorted(path.name for path in Path("pcmrs/workflows").glob("*.toml")))
def test_shipped_workflows(name: str) -> None:
    assert trace(load_blueprint(Path("pcmrs/workflows") / name), Random(name), 150) > 10


def test_a_child_that_refines_one_state_is_drawn_inside_it() -> None:
    assert nesting_of(RATMS).nested == {"placement"}
    peer: Any = Peer(scxml(RATMS))
    assert not any(state.startswith("placement") for state in peer.configuration())
    peer.send("robot.connect")
    assert "placement.unknown" in peer.configuration()
