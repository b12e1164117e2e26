"""An operator who sees the state does the next step of the procedure, by bus and by wire."""

from __future__ import annotations

import itertools

import pytest
from msgspec.structs import replace

from pcmrs.gateway.commands import COMMANDS
from pcmrs.messages import Snapshot, StopState
from pcmrs_lab.campaign.explore.next_step_policy import AT_THE_BODY, WITH_STIMULATOR, Step, next_step_policy
from tests.unit.lab.blueprints import ratms
from tests.unit.lab.scripted_client import snapshot

READY = {"robot": "1", "registration": "111", "toolplan": "1", "placement": "retracted"}
TURNS = range(60)


def steps(branches: dict[str, str]) -> set[str]:
    shown = replace(snapshot(), branches=READY | branches)
    return {next_step_policy(shown, turn)[0] for turn in TURNS}


@pytest.mark.parametrize(
    ("branches", "expected"),
    [
        ({"robot": "0"}, {"robot.connect", "wire:rob_conn_onxxxxx"}),
        ({"placement": "unknown"}, {"placement.locate"}),
        ({"placement": "held"}, {"placement.back_off"}),
        ({"registration": "000"}, {"landmarks", "registration.plan_landmarks"}),
        ({"registration": "100"}, {"digitization.digitize_all", "wire:start_autodigitz"}),
        ({"registration": "110"}, {"registration.register", "wire:start_registrati"}),
        ({"toolplan": "0"}, {"pose", "toolplan.plan"}),
        ({}, {"placement.approach"}),
        ({"placement": "standoff"}, {"placement.confirm", "placement.approach", "pose"}),
        ({"placement": "replanned"}, {name for name, _ in AT_THE_BODY["replanned"]}),
        ({"placement": "placed"}, {name for name, _ in AT_THE_BODY["placed"]}),
        ({"placement": "guided"}, {name for name, _ in AT_THE_BODY["guided"]}),
    ],
)
def test_the_next_step_depends_on_the_state(branches: dict[str, str], expected: set[str]) -> None:
    assert steps(branches) == expected


def test_nobody_sees_the_state_of_a_daemon_that_is_gone() -> None:
    assert next_step_policy(None, 7) == ("robot.connect", {})


def test_a_stop_is_acknowledged_by_the_number_that_is_shown() -> None:
    shown = replace(snapshot(latched=True), branches=READY, stop=StopState(number=3))
    found = [next_step_policy(shown, turn) for turn in TURNS]
    assert ("robot.acknowledge", {"stop": 3}) in found
    assert ("placement.home", {}) in found, "some do not look"
    assert len({name for name, _ in found}) == 2


@pytest.mark.parametrize("placement", ["placed", "following"])
def test_pulses_are_given_only_at_the_body(placement: str) -> None:
    of_stimulator = {name for name, _ in WITH_STIMULATOR}
    assert of_stimulator <= steps({"placement": placement, "stimulation": "disarmed"})
    assert not of_stimulator & steps({"placement": placement})
    assert not of_stimulator & steps({"placement": "standoff", "stimulation": "disarmed"})


def _all_states() -> list[Snapshot]:
    branches = [ratms().branches[name].states for name in ("robot", "registration", "toolplan", "placement")]
    shown = []
    for states in itertools.product(*branches):
        named = dict(zip(("robot", "registration", "toolplan", "placement"), states, strict=True))
        shown += [replace(snapshot(latched=latched), branches=named) for latched in (False, True)]
    return shown


def _exists(step: Step) -> bool:
    kind, _, name = step[0].partition(":")
    if kind == "wire":
        return name in COMMANDS
    branch, _, operation = step[0].partition(".")
    return step[0] in ("landmarks", "pose") or operation in ratms().branches[branch].operations


def test_there_is_a_step_in_every_state_and_it_exists() -> None:
    for shown in _all_states():
        assert all(_exists(next_step_policy(shown, turn)) for turn in range(12))
