"""Escape is Stop while anything moves, is armed or at the patient; otherwise it closes a dialog first."""

from __future__ import annotations

import pytest
from msgspec.structs import replace

from pcmrs.console._escape import EscapeKey
from pcmrs.messages import BlueprintTag, Running, Snapshot
from tests.support.shipped import shipped_blueprint

BLUEPRINT = shipped_blueprint("ratms_threshold")
START = Snapshot(
    sequence=1, branches=BLUEPRINT.initial(), flags={}, running=[], latched=False,
    blueprint=BlueprintTag(id="ratms_threshold", version="1", hash="0"),
)  # fmt: skip
ESCAPE = EscapeKey(BLUEPRINT)


def running(branch: str, operation: str) -> Snapshot:
    return replace(START, running=[Running(branch=branch, operation=operation, id="1")])


def test_without_a_dialog_it_is_always_stop() -> None:
    assert ESCAPE.stops(START, dialog=False)
    assert ESCAPE.stops(None, dialog=False)


@pytest.mark.parametrize(
    ("shown", "stops"),
    [
        (START, False),
        (None, True),
        (running("registration", "register"), False),
        (running("placement", "home"), True),
        (running("stimulation", "arm"), True),
        (running("unheard", "of"), True),
        (replace(START, branches=START.branches | {"placement": "placed"}), True),
        (replace(START, branches=START.branches | {"stimulation": "armed"}), True),
        (replace(START, branches=START.branches | {"placement": "retracted"}), False),
    ],
    ids=["idle", "unknown", "pure", "motion", "arming", "other", "placed", "armed", "clear"],
)
def test_in_a_dialog_it_is_stop_where_that_matters(shown: Snapshot | None, stops: bool) -> None:
    assert ESCAPE.stops(shown, dialog=True) == stops
