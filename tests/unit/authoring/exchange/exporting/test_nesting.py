"""Branches that are drawn inside a state of their parent."""

from __future__ import annotations

from random import Random

import pytest

from pcmrs.authoring.exchange.exporting._nesting import nesting_of
from pcmrs.authoring.exchange.exporting.scxml import scxml
from pcmrs.fsm.files.load import read_blueprint
from tests.support.shipped import shipped_blueprint
from tests.unit.authoring.exchange.scxml_peer import Peer, trace


def test_a_child_that_refines_one_state_is_drawn_inside_it() -> None:
    assert nesting_of(shipped_blueprint("ratms")).nested == {"placement", "teleoperation"}
    peer = Peer(scxml(shipped_blueprint("ratms")))
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
