"""`pcmrs fsm simulate`: typed commands, scripts and random steps."""

from __future__ import annotations

from pathlib import Path

import msgspec
import pytest
from click.testing import CliRunner, Result
from hypothesis import given
from hypothesis import strategies as st

from pcmrs.authoring.trial.session import SimulationSession, TrialStep
from pcmrs.cli import main
from tests.support.shipped import shipped_blueprint
from tests.support.trials import examples
from tests.unit.fsm.timed_workflow import TIMED

RATMS = shipped_blueprint("ratms")


def simulate(*words: str, lines: str | bytes | None = None) -> Result:
    return CliRunner().invoke(main, ["fsm", "simulate", *words], input=lines)


def test_a_script_is_followed_line_by_line() -> None:
    lines = (
        "registration.plan_landmarks\nwhy placement.approach\nrobot.connect\nundo\nundo\nundo\nreset\nhelp\nquit\nnever"
    )
    run = simulate("ratms", lines=lines)
    assert run.exit_code == 0
    told = [line for line in run.output.splitlines() if line and line[0] != " "]
    denial = SimulationSession(RATMS).denial("placement.approach")
    assert denial is not None
    assert told[:6] == [
        "registration.plan_landmarks: accepted",
        f"{denial.code}: {denial.text}",
        "robot.connect: accepted",
        "registration=100 digitization=0 toolplan=0 robot=0 placement=unknown alignment=0 teleoperation=off",
        "registration=000 digitization=0 toolplan=0 robot=0 placement=unknown alignment=0 teleoperation=off",
        "There is nothing to undo.",
    ]
    assert "    registration: 000 → 100" in run.output
    assert "never" not in run.output


def test_a_number_is_that_line_of_the_list() -> None:
    choices = SimulationSession(RATMS).choices()
    run = simulate("ratms", lines=f"{choices.index('robot.connect') + 1}\n0\n{len(choices) * 2}\n")
    assert "robot.connect: accepted" in run.output
    assert run.stderr.count("is not in the list") == 2


def test_lines_that_are_no_commands_are_reported() -> None:
    run = simulate("ratms", lines="\x00\n:::\n..\n99999999999999999999\nwhy\nwhy x.y\n")
    assert run.exit_code == 0
    assert run.stderr.count("\n") == 4


@given(st.binary(max_size=300))
@examples(15)
@pytest.mark.nightly
def test_any_bytes_can_be_typed(lines: bytes) -> None:
    run = simulate("ratms", lines=lines)
    assert run.exit_code == 0
    assert run.exception is None


def test_random_steps_as_json_are_one_object_a_line() -> None:
    run = simulate("ratms", "--random", "30", "--seed", "5", "--json")
    steps = [msgspec.json.decode(line, type=TrialStep) for line in run.output.splitlines()]
    assert steps == list(SimulationSession(RATMS).random_walk(30, 5))


def test_unreadable_workflow_ends_with_5(tmp_path: Path) -> None:
    file = tmp_path / "no.toml"
    file.write_bytes(b"\xff")
    assert simulate(str(file)).exit_code == 5
    assert simulate(str(tmp_path / "none.toml")).exit_code == 5


def test_a_wait_lets_timers_expire(tmp_path: Path) -> None:
    workflow = tmp_path / "timed.toml"
    workflow.write_text(TIMED)
    run = simulate(str(workflow), lines="tool.place\nwait 60\nwait 540\nwait soon\nwait\n")
    assert "60 s: wait 60: waited" in run.output
    assert "    timer tool.idle: 540 s left" in run.output
    assert "600 s: tool.left_alone: accepted, by timer tool.idle" in run.output
    assert run.stderr.count("cannot be a time") == 2
