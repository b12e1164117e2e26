"""Activities that contradict other declarations are reported where they are."""

from __future__ import annotations

import pytest

from pcmrs.fsm import examine
from tests.unit.fsm.arm_workflow import ARM

FAULTS = {
    # what is replaced, by what, the code of the finding, a part of its text
    "unknown state": ("near = { run", "far = { run", "unknown_state", "'far'"),
    "every state": ("near = { run", '"*" = { run', "unknown_state", "'*'"),
    "unknown operation": ('ended = "lost_sight"', 'ended = "gone"', "unknown_operation", "arm.gone"),
    "no name of a function": ('"watch_head"', '"watch--head"', "bad_name", "'watch--head'"),
    "where the branch starts": ("near = { run", "away = { run", "bad_activity", "never run in the starting state"),
    "ended is no event": ('ended = "lost_sight"', 'ended = "withdraw"', "bad_activity", "not an event"),
    "ended is not valid there": ('ended = "lost_sight"', 'ended = "lost"', "bad_activity", "not valid in that state"),
    "ended keeps the state": ('from = ["near"]\nto = "held"', 'from = ["near"]\nto = "near"', "bad_activity", "keep"),
    "ended may fail": ('to = "held"\nevent', 'to = "held"\nsteps = ["see"]\nevent', "bad_activity", "may keep"),
    "ended may be refused": ('to = "held"\nevent', 'to = "held"\nchecks = ["see"]\nevent', "bad_activity", "checks"),
    "ended requires more": (
        'to = "held"\nevent',
        'to = "held"\nrequires = { robot = ["ready"] }\nevent',
        "bad_activity",
        "requires",
    ),
    "ended moves": (
        'to = "held"\nevent',
        'to = "held"\naffects_patient = true\nevent',
        "bad_operation",
        "no user asks for it",
    ),
    "entered without an approach": (
        'to = "following"\nmotion = "approach"',
        'to = "following"\nmotion = "retreat"',
        "bad_activity",
        "follow leads there, and not as an approach",
    ),
    "entered by a failure": (
        'to = "near"\nmotion = "approach"\nsteps = ["move"]\non_failure = "stopped"',
        'to = "near"\nmotion = "approach"\nsteps = ["move"]\non_failure = "following"',
        "bad_activity",
        "approach leads there, and not as an approach that ends",
    ),
    "kept by a motion": (
        'from = ["near"]\nto = "following"',
        'from = ["near", "following"]\nto = "following"',
        "bad_activity",
        "follow takes over from it",
    ),
    "kept by a motion that fails": (
        '"stopped"]\nto = "away"\nmotion = "retreat"\nsteps = ["move"]\non_failure = "stopped"',
        '"stopped"]\nto = "away"\nmotion = "retreat"\nsteps = ["move"]\non_failure = { near = "stopped", '
        'following = "following", held = "stopped", stopped = "stopped" }',
        "bad_activity",
        "withdraw takes over from it",
    ),
    "entered by a revocation": (
        "[branches.arm.states]",
        'revocations = [{ by = ["robot"], from = ["held"], to = "following" }]\n[branches.arm.states]',
        "bad_activity",
        "another branch takes this one there",
    ),
    "set from above": (
        'from = ["off"]\nto = "ready"',
        'from = ["off"]\nto = "ready"\nsets = { arm = "following" }',
        "bad_activity",
        "another branch takes this one there",
    ),
    "beside the motion of another branch": (
        "[branches.robot.operations.disconnect]",
        '[branches.robot.operations.home]\nfrom = ["ready"]\nto = "ready"\nmotion = "retreat"\nsteps = ["move"]\n'
        'on_failure = "off"\non_unknown = "off"\n[branches.robot.operations.disconnect]',
        "bad_activity",
        "robot.home moves the robot",
    ),
    "unknown key": ("moves = true", "move = true", "bad_value", "move"),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_a_fault_is_named(fault: str) -> None:
    old, new, code, words = FAULTS[fault]
    assert old in ARM
    findings = examine(ARM.replace(old, new).encode()).findings
    assert [(finding.code, words in finding.text) for finding in findings[:1]] == [(code, True)], findings
    assert {finding.code for finding in findings} == {code}
    assert all(finding.line > 1 for finding in findings)


def test_motion_elsewhere_is_sound_if_it_requires_standstill() -> None:
    old, new, *_ = FAULTS["beside the motion of another branch"]
    allowed = new.replace('motion = "retreat"', 'requires = { arm = ["away"] }\nmotion = "retreat"')
    assert examine(ARM.replace(old, allowed).encode()).sound


def test_activities_that_move_belong_to_one_branch() -> None:
    lost = "[branches.robot.operations.lost]\nfrom = ['off']\nto = 'ready'\nevent = true\n"
    activities = "activities = { off = { run = 'heat', ended = 'lost', moves = true } }\n"
    text = ARM.replace("[branches.robot]\n", f"[branches.robot]\n{activities}")
    text = text.replace("[branches.robot.operations.disconnect]", f"{lost}[branches.robot.operations.disconnect]")
    texts = [finding.text for finding in examine(text.encode()).findings if finding.code == "bad_activity"]
    assert any("keep those of one branch" in said for said in texts)
