"""Timers that contradict other declarations, or that would do something unasked, are reported where they are."""

from __future__ import annotations

import pytest

from pcmrs.fsm import examine
from pcmrs.fsm.files.dump import blueprint_toml
from tests.unit.fsm.timed_workflow import TIMED, timed_blueprint

EVENT = 'from = ["placed"]\nto = "held"\nevent = true'
FAULTS = {
    # what is replaced, by what, the code of the finding, a part of its text
    "unknown state": ('states = ["placed"]', 'states = ["gone"]', "unknown_state", "'gone'"),
    "unknown operation": ('posts = "left_alone"', 'posts = "gone"', "unknown_operation", "tool.gone"),
    "restarted by an unknown one": ('"pulse.give"]', '"pulse.gone"]', "unknown_operation", "pulse.gone"),
    "bad name": ("idle = {", '"i dle" = {', "bad_name", "'i dle'"),
    "no states": ('states = ["placed"]', "states = []", "bad_timer", "no states"),
    "where the branch starts": ('states = ["placed"]', 'states = ["away"]', "bad_timer", "never begin in away"),
    "no event": ('posts = "left_alone"', 'posts = "withdraw"', "bad_timer", "not an event"),
    "affects the patient": (
        'posts = "rested"',
        'posts = "give"',
        "bad_timer",
        "nothing does that unless a person requests it",
    ),
    "event with checks": (EVENT, EVENT + '\nchecks = ["see"]', "bad_timer", "checks or requires"),
    "event that requires": (EVENT, EVENT + '\nrequires = { pulse = ["ready"] }', "bad_timer", "checks or requires"),
    "event with steps": (EVENT, EVENT + '\nsteps = ["look_at_tool"]', "bad_timer", "a step may fail"),
    "event with arguments": (EVENT, EVENT + '\npayload = "plan"', "bad_timer", "has arguments"),
    "event that unlatches": (EVENT, EVENT + "\nunlatches = true", "bad_timer", "only a person may"),
    "event that Stop blocks": (EVENT, EVENT + "\nblocked_when_latched = true", "bad_timer", "blocked by Stop"),
    "event of several outcomes": (
        EVENT,
        'from = ["placed"]\noutcomes = { a = { to = "held" }, b = { to = "away" } }\nevent = true',
        "bad_timer",
        "several outcomes",
    ),
    "not valid there": ('states = ["placed"]', 'states = ["held"]', "bad_timer", "not valid in held"),
    "repeats an event that leads away": (
        'posts = "left_alone"',
        'posts = "left_alone", repeat = true',
        "bad_timer",
        "cannot repeat",
    ),
    "no time": ("after_s = 600", "after_s = 0", "bad_timer", "from 0.1 on"),
    "endless time": ("after_s = 600", "after_s = inf", "bad_timer", "from 0.1 on"),
    "no time in the limit": ("rest_s = 5", 'rest_s = "soon"', "bad_timer", "procedure.limits.rest_s"),
    "unknown limit": ("rest_s = 5", "other_s = 5", "bad_timer", "is missing"),
    "unknown key": ("after_s = 600", "after_s = 600, every = 5", "bad_value", "every"),
}


@pytest.mark.parametrize("fault", list(FAULTS))
def test_a_contradiction_is_found(fault: str) -> None:
    old, new, code, text = FAULTS[fault]
    assert old in TIMED
    findings = examine(TIMED.replace(old, new, 1).encode()).findings
    assert code in {finding.code for finding in findings}
    assert any(text in finding.text for finding in findings), [finding.text for finding in findings]
    assert all(finding.line for finding in findings)


def test_the_workflow_itself_is_sound_and_reads_back() -> None:
    assert examine(TIMED.encode()).findings == []
    again = examine(blueprint_toml(timed_blueprint()).encode())
    assert again.blueprint == timed_blueprint()


def test_a_timer_whose_event_may_be_denied_is_found() -> None:
    """Its parent refuses the signal in a state in which the timer runs."""
    text = (
        TIMED
        + """
[branches.tool.operations.inner_changed]
from = ["away", "placed"]
to = { away = "away", placed = "placed" }
iio = true

[branches.inner]
level = 2
states = { off = "", on = "" }
emits = { "*" = "inner_changed" }
timers = { wait = { states = ["on"], after_s = 1, posts = "ended" } }
parent = { branch = "tool", start = "away", compatible = { "*" = ["away", "placed", "held"] } }

[branches.inner.operations.begin]
from = ["off"]
to = "on"

[branches.inner.operations.ended]
from = ["on"]
to = "off"
event = true

[branches.inner.operations.reinit]
from = ["*"]
to = "off"
rio = true
"""
    )
    (found,) = (each for each in examine(text.encode()).findings if each.code == "timer_stuck")
    assert found.path == ("branches", "inner", "timers", "wait")
    assert "tool.left_alone" in (found.commands or ())
