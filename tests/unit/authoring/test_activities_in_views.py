"""Every view of a workflow shows its activities."""

from __future__ import annotations

from pcmrs.authoring.chart import dot, mermaid, svg
from pcmrs.authoring.exchange.exporting.scxml import scxml
from pcmrs.authoring.exchange.exporting.table import table
from pcmrs.authoring.exchange.importing.mermaid import from_mermaid
from pcmrs.authoring.exchange.importing.scxml import from_scxml
from pcmrs.fsm import parse_blueprint
from tests.unit.fsm.arm_workflow import arm_blueprint


def test_every_view_shows_them() -> None:
    for drawn in (svg(arm_blueprint()), dot(arm_blueprint()), scxml(arm_blueprint())):
        assert drawn.count("do / follow_head") == 1
        assert drawn.count("do / watch_head") == 1
    assert "note right of arm_IS_following : do / follow_head" in mermaid(arm_blueprint())
    rows = [line for line in table(arm_blueprint()).splitlines() if "follow_head" in line]
    assert rows == [
        "| arm | activity (moves) | following |  |  | follow_head | being in the state | lost when it ends |"
    ]


def test_a_chart_with_them_is_read_again_without() -> None:
    alone = parse_blueprint(
        b"""id = "x"
version = "1"
goal = { x = ["b"] }
[branches.x]
states = { a = "", b = "" }
activities = { b = { run = "watch", ended = "lost" } }
[branches.x.operations.go]
from = ["a"]
to = "b"
[branches.x.operations.lost]
from = ["b"]
to = "a"
event = true
"""
    )
    for read, drawn in ((from_scxml, scxml(alone)), (from_mermaid, mermaid(alone))):
        again, findings = read(drawn.encode())
        assert again is not None, findings
        assert not any(branch.activities for branch in again.branches.values())
