"""Planning takes its time in simulated time, too: others act while a motion is planned."""

from __future__ import annotations

import pytest

from pcmrs.workflows._correction import CORRECTION_TIME
from pcmrs_lab.campaign.explore.script import Act, SessionScript
from pcmrs_lab.campaign.explore.session import run_session

BEFORE = [Act(1.0, "go_on", "anna", {"turn": turn}) for turn in (1, 0, 1, 0, 1)]
APPROACH = Act(1.0, "placement.approach", "anna", waits=False)


CONFIRM = Act(1.0, "placement.confirm", "anna", waits=False)
CORRECTION = "plan:placement.confirm:correction_possible"


@pytest.mark.parametrize(
    ("meanwhile", "seen", "never"),
    [
        pytest.param("stop", "rejected placement.approach", "accepted placement.approach", id="stop"),
        pytest.param(
            "registration.clear_registration",
            "accepted placement.approach",
            "accepted registration.clear_registration",
            id="a change of what it rests on",
        ),
    ],
)
def test_event_during_planning_decides_the_motion(meanwhile: str, seen: str, never: str) -> None:
    act = Act(0.05, meanwhile, "ben", window="plan:placement.approach", held=0.3)
    found = run_session(SessionScript(seed=5, acts=[*BEFORE, APPROACH, act]))
    assert (found.invariant, found.text) == ("", "")
    assert (found.seen.get(seen), found.seen.get(never)) == (1, None)


@pytest.mark.parametrize(
    ("meanwhile", "held"),
    [
        pytest.param("stop", 0.3, id="stop"),
        pytest.param("repeat", CORRECTION_TIME + 0.1, id="a late answer"),
    ],
)
def test_correction_is_planned_in_a_window_with_a_limit(meanwhile: str, held: float) -> None:
    approach = Act(1.0, "placement.approach", "anna")
    act = Act(0.05, meanwhile, "ben", window=CORRECTION, held=held)
    found = run_session(SessionScript(seed=5, acts=[*BEFORE, approach, CONFIRM, act]))
    assert (found.invariant, found.text) == ("", "")
    assert found.seen.get("failed placement.confirm") == 1
