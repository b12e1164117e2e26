"""Sessions that are explored: they hold, they reproduce, they reach what they should, and mutants are found."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

from pcmrs_lab.campaign.explore.exploring import SessionTask, explore, run_sessions
from pcmrs_lab.campaign.explore.generate import draw_script
from pcmrs_lab.campaign.explore.next_step_policy import WITH_STIMULATOR
from pcmrs_lab.campaign.explore.script import Act, SessionScript, shrink
from pcmrs_lab.campaign.explore.session import run_session
from pcmrs_lab.campaign.explore.settings import workflow_of
from pcmrs_lab.scale.tasks import Workers
from tests.system.lab.exploring.exploring_mutants import MUTANTS, SCRIPTED

TO_THE_HEAD = [Act(1.0, "go_on", "anna", {"turn": turn}) for turn in (1, 0, 1, 0, 1, 0, 1, 0, 0, 0)]
"""From nothing to the coil at its place."""

FINDING: dict[str, list[Act]] = {
    "latch_not_checked": [*TO_THE_HEAD[:8], Act(1.0, "stop", "ben"), Act(2.0, "placement.back_off", "anna")],
    "stop_does_not_latch": [*TO_THE_HEAD[:3], Act(1.0, "stop", "ben")],
    "acknowledged_before_written": TO_THE_HEAD[:3],
    "repeats_are_performed": [*TO_THE_HEAD[:4], Act(1.0, "toolplan.clear", "ben"), Act(1.0, "repeat", "ben")],
    "unasked_motion_is_ignored": [
        Act(1.0, "robot.connect", "anna"),
        Act(5.0, "fault:guide_by_hand", "", {"joint": 2, "angle": 0.2}),
    ],
    "commands_have_no_time_of_arrival": [
        *TO_THE_HEAD[:5],
        Act(2.0, "fault:held_up", "", {"process": "daemon", "seconds": 0.5}, waits=False),
        Act(0.1, "placement.approach", "anna"),
    ],
    "reports_of_devices_are_lost": [
        Act(1.0, "robot.connect", "anna"),
        Act(5.0, "fault:e_stop", "", {"on": True, "lasts": 2.0}),
    ],
}
"""Mutant to what shows it."""


def test_session_holds_and_its_seed_fixes_its_journal() -> None:
    """Also in another process, where sets and dictionaries of text are walked through in another order."""
    found = run_sessions([SessionTask("ratms", "kinematic", 3)])[0]
    assert (found.invariant, found.text) == ("", "")
    code = "from pcmrs_lab.campaign.explore.exploring import SessionTask, run_sessions; "
    code += "print(run_sessions([SessionTask('ratms', 'kinematic', 3)])[0].digest)"
    environment = {**os.environ, "PYTHONHASHSEED": "4711"}
    other = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=True)
    assert other.stdout.strip() == found.digest


def test_the_head_is_reached_when_nothing_is_wrong() -> None:
    found = run_session(SessionScript(seed=1, acts=TO_THE_HEAD))
    assert (found.invariant, found.text) == ("", "")
    assert found.seen["accepted placement.confirm"] == 2, "the second one aligns the placed tool again"


def test_a_registration_that_is_taken_back_is_one_of_the_journal() -> None:
    """It has the id of the command that took it back."""
    found = run_session(SessionScript(seed=1, acts=[*TO_THE_HEAD[:4], Act(1.0, "registration.use_previous", "ben")]))
    assert (found.invariant, found.text) == ("", "")
    assert found.seen["accepted registration.use_previous"] == 1


def test_frame_stamped_ahead_during_a_swap_validates_no_tool() -> None:
    """Otherwise the reference would count as being where the witness is, and not be believed any more afterwards."""
    swap = {"first": "witness", "second": "body_ref", "on": True, "lasts": 9.7}
    found = run_session(
        SessionScript(seed=1, acts=[Act(0.7, "fault:tool_swap", "", swap), Act(0.6, "fault:frame_ahead")])
    )
    assert (found.invariant, found.text) == ("", "")


def test_poses_continue_after_a_restart_if_head_moved_in_a_swap() -> None:
    """Seed 8781342: the reference came to where the other tool had been; the tracker is restarted, as is advised."""
    swap = {"first": "body_ref", "second": "witness", "on": True, "lasts": 12.954}
    acts = [
        Act(0.13, "fault:tool_swap", "", swap, waits=False),
        Act(1.465, "fault:dash_head", "", {"millimetres_per_second": 145.7869697011158}, waits=False),
    ]
    found = run_session(SessionScript(8781342, workflow="femoroplasty", slow=0.1, acts=acts))
    assert (found.invariant, found.text) == ("", "")


def test_tracker_is_restarted_if_its_first_poses_were_swapped() -> None:
    """Seed 9040404: no feed knows which body is which if the first frames after a restart already show a swap."""
    swap = {"first": "witness", "second": "body_ref", "on": True, "lasts": 2.931}
    acts = [
        Act(0.709, "fault:tracker_restart", "", {}, waits=False),
        Act(0.637, "fault:tool_swap", "", swap, waits=False),
    ]
    found = run_session(SessionScript(9040404, workflow="ratms_threshold", slow=0.3, acts=acts))
    assert (found.invariant, found.text) == ("", "")


def test_promise_about_accepted_commands_is_not_one_about_states() -> None:
    """Seed 9060648: no_hole_is_drilled_twice says what is not accepted, and nothing was drilled."""
    surgeon = {"surgeon": "simulated surgeon"}
    acts = [
        Act(13.354, "treatment.confirm_clear", "anna", surgeon),
        Act(12.866, "treatment.abandon", "anna", surgeon, waits=False),
    ]
    found = run_session(SessionScript(9060648, workflow="femoroplasty", coded=True, acts=acts))
    assert (found.invariant, found.text) == ("", "")


@pytest.mark.nightly
def test_a_pulse_is_given_when_nothing_is_wrong() -> None:
    """What is explored must come to what matters: rates that are too low for a pulse would hide all that follows."""
    stimulation = [Act(6.0, name, "anna", arguments) for name, arguments in WITH_STIMULATOR]
    found = run_session(SessionScript(seed=1, workflow="ratms_threshold", acts=[*TO_THE_HEAD[:8], *stimulation]))
    assert (found.invariant, found.text) == ("", "")
    assert found.seen["accepted stimulation.fire"] == 2


@pytest.mark.parametrize("name", [*MUTANTS, *SCRIPTED])
def test_a_guard_that_was_taken_out_is_missed(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    script = SessionScript(seed=5, acts=FINDING[name])
    assert not run_session(script).invariant
    (MUTANTS | SCRIPTED)[name](monkeypatch)
    assert run_session(script).invariant


@pytest.mark.nightly
@pytest.mark.timeout(1200)
@pytest.mark.parametrize("name", MUTANTS)
def test_exploring_finds_and_shrinks_every_mutant(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    MUTANTS[name](monkeypatch)
    blueprint = workflow_of("ratms").blueprint
    scripts = (draw_script(blueprint, "ratms", seed) for seed in range(100))
    broken, invariant = next((each, found.invariant) for each in scripts if (found := run_session(each)).invariant)
    shorter = shrink(broken, lambda each: run_session(each).invariant == invariant)
    assert len(shorter.acts) <= min(12, len(broken.acts))
    assert run_session(shorter).invariant == invariant


@pytest.mark.parametrize("first", range(1001, 1021, 5))
@pytest.mark.nightly
def test_sessions_hold(first: int) -> None:
    found = run_sessions([SessionTask("ratms", "kinematic", seed) for seed in range(first, first + 5)])
    assert {each.seed: (each.invariant, each.text) for each in found if each.invariant} == {}


@pytest.mark.nightly
@pytest.mark.timeout(1800)
@pytest.mark.parametrize("workflow", ["femoroplasty", "grid_mapping", "ratms_threshold"])
def test_sessions_of_other_workflows_hold(workflow: str) -> None:
    assert explore(workflow, 1, 50, workers=Workers(2)).broken == []


@pytest.mark.nightly
@pytest.mark.timeout(3600)
def test_sessions_with_a_heavy_arm_hold() -> None:
    assert explore("ratms", 1, 10, workers=Workers(2), physics="mujoco").broken == []


@pytest.mark.nightly
@pytest.mark.timeout(7200)
def test_500_sessions_hold_and_reach_every_fault() -> None:
    report = explore("ratms", 1, 500, workers=Workers(2))
    assert report.broken == []
    assert report.not_reached == []
