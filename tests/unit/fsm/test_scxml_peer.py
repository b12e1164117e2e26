"""The engine and another implementation of state charts take the same path through any workflow."""

from __future__ import annotations

from pathlib import Path
from random import Random

import pytest

from pcmrs.authoring.exchange.exporting.events import OperationEnding, commands
from pcmrs.authoring.exchange.exporting.nesting import nesting_of
from pcmrs.authoring.exchange.exporting.scxml import scxml
from pcmrs.fsm import Blueprint
from pcmrs.fsm.closure import Denial
from pcmrs.fsm.engine import Engine
from pcmrs.fsm.files.load import read_blueprint
from tests.unit.fsm.random_blueprints import random_blueprint
from tests.unit.fsm.scxml_peer import Peer, expected, fits

WORKFLOWS = Path("pcmrs/workflows")


def workflow(name: str) -> Blueprint:
    blueprint, findings = read_blueprint((WORKFLOWS / name).read_bytes(), name, WORKFLOWS)
    assert blueprint is not None, findings
    return blueprint


RATMS = workflow("ratms.toml")


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


@pytest.mark.parametrize("name", sorted(path.name for path in WORKFLOWS.glob("*.toml")))
def test_shipped_workflows(name: str) -> None:
    assert trace(workflow(name), Random(name), 150) > 10


def test_a_child_that_refines_one_state_is_drawn_inside_it() -> None:
    assert nesting_of(RATMS).nested == {"placement", "teleoperation"}
    peer = Peer(scxml(RATMS))
    assert not any(state.startswith("placement") for state in peer.configuration())
    peer.send("robot.connect")
    assert "placement.unknown" in peer.configuration()


THREE_LEVELS = """
id = "levels"
version = "1"
[branches.a]
states = { a0 = "", a1 = "" }
[branches.a.operations]
go = { from = ["*"], to = { a0 = "a1", a1 = "a0" } }
kept = { from = ["a1"], to = "a1", iio = true }
[branches.b]
level = 2
states = { b0 = "", b1 = "" }
parent = { branch = "a", start = "a1", compatible = { b0 = ["a0", "a1"], b1 = ["a1"] } }
emits = { b0 = "kept", b1 = "kept" }
[branches.b.operations]
go = { from = ["*"], to = { b0 = "b1", b1 = "b0" } }
kept = { from = ["*"], to = { b0 = "b0", b1 = "b1" }, iio = true, signals = SIGNALS }
reinit = { from = ["*"], to = "b0", rio = true }
[branches.c]
level = 3
states = { c0 = "", c1 = "" }
parent = { branch = "b", start = "b0", compatible = { c0 = ["b0", "b1"], c1 = ["b0"] } }
emits = { c0 = "kept", c1 = "kept" }
revocations = [REVOCATION]
[branches.c.operations]
go = { from = ["*"], to = { c0 = "c1", c1 = "c0" } }
reinit = { from = ["*"], to = "c0", rio = true }
"""
REVOCATION = '{ by = ["a"], from = ["c1"], to = "c0" }'


@pytest.mark.parametrize(
    ("signals", "revocation", "nested"),
    [("true", REVOCATION, {"b", "c"}), ("false", REVOCATION, {"b"}), ("true", "", {"b"})],
)
def test_branch_that_may_leave_its_start_elsewhere_is_not_nested(
    signals: str, revocation: str, nested: set[str]
) -> None:
    """c is at home in b0, where b starts: it must not move, and not stay moved, while a is in a0."""
    text = THREE_LEVELS.replace("SIGNALS", signals).replace("REVOCATION", revocation)
    blueprint, findings = read_blueprint(text.encode(), "levels")
    assert blueprint is not None, findings
    assert nesting_of(blueprint).nested == nested
    assert trace(blueprint, Random(1), 100) > 30
