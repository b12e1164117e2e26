"""Simulated walks: what is offered is accepted, what is not is refused, and everything can be taken back."""

from __future__ import annotations

from pathlib import Path
from random import Random

import msgspec
import pytest
from click.testing import CliRunner, Result
from hypothesis import given
from hypothesis import strategies as st

from pcmrs.authoring.trial.session import SimulationSession, TrialStep
from pcmrs.cli import main
from pcmrs.errors import RefusalError
from pcmrs.fsm import Blueprint, load_blueprint
from tests.support.ratms_oracle import BLUEPRINT, INITIAL, Joint, all_operations, as_dict, expected
from tests.support.trials import examples
from tests.unit.fsm.random_blueprints import blueprints

RATMS = load_blueprint(BLUEPRINT)


def simulate(*words: str, lines: str | bytes | None = None) -> Result:
    return CliRunner().invoke(main, ["fsm", "simulate", *words], input=lines)


def joint(walk: SimulationSession) -> Joint:
    return tuple(walk.states().values())  # type: ignore[return-value]


@given(st.integers(0, 10_000))
@examples(20)
def test_every_random_step_is_what_the_specification_says(seed: int) -> None:
    walk = SimulationSession(RATMS)
    before = INITIAL
    for step in walk.random_walk(40, seed):
        name, _, ending = step.command.partition(":")
        branch, _, operation = name.partition(".")
        endings = expected(before, branch, operation)
        if endings is None:
            assert (step.decision, joint(walk)) == ("rejected", before)
        else:
            assert step.decision == (ending if ending in ("failed", "unknown") else "accepted")
            assert joint(walk) == endings[ending or "done" if "done" in endings else ending]
        before = joint(walk)


def test_the_same_seed_is_the_same_walk() -> None:
    walks = [list(SimulationSession(RATMS).random_walk(100, seed)) for seed in (7, 7, 8)]
    assert walks[0] == walks[1] != walks[2]
    assert {step.decision for step in walks[0]} == {"accepted", "rejected", "failed", "unknown"}


@given(blueprints(), st.integers(0, 1000))
@examples(30)
def test_everything_can_be_taken_back(blueprint: Blueprint, seed: int) -> None:
    walk = SimulationSession(blueprint)
    passed = [walk.states()]
    for step in walk.random_walk(10, seed):
        assert walk.states() == step.states
        passed.append(walk.states())
    for states in passed[-2::-1]:
        assert walk.undo()
        assert walk.states() == states
    assert not walk.undo()


@given(blueprints(), st.randoms(use_true_random=False))
@examples(30)
def test_offered_choices_are_accepted_and_others_refused(blueprint: Blueprint, rng: Random) -> None:
    walk = SimulationSession(blueprint)
    list(walk.random_walk(5, rng.randrange(1000)))
    offered = {choice.partition(":")[0] for choice in walk.choices()}
    for name, branch in blueprint.branches.items():
        for operation, spec in branch.operations.items():
            full = f"{name}.{operation}"
            assert (full in offered) == (walk.denial(full) is None and not spec.iio)
    for choice in walk.choices():
        assert walk.ask(choice).decision != "rejected"
        walk.undo()


def test_the_choices_of_ratms_are_those_of_the_specification() -> None:
    walk = SimulationSession(RATMS)
    offered = {choice.partition(":")[0] for choice in walk.choices()}
    assert offered == {f"{b}.{o}" for b, o in all_operations() if expected(INITIAL, b, o) is not None}


@pytest.mark.parametrize(
    ("command", "code"),
    [
        ("robots.connect", "unknown_branch"),
        ("robot.conect", "unknown_operation"),
        ("connect", "unknown_branch"),
        ("robot.connect:well", "unknown_outcome"),
    ],
)
def test_unknown_command_is_an_error_that_changes_nothing(command: str, code: str) -> None:
    walk = SimulationSession(RATMS)
    with pytest.raises(RefusalError) as refused:
        walk.ask(command)
    assert refused.value.refusal_code == code
    assert walk.steps == []
    assert walk.states() == as_dict(INITIAL)


def test_operation_with_several_outcomes_needs_one_named() -> None:
    walk = SimulationSession(RATMS)
    walk.ask("robot.connect")
    with pytest.raises(RefusalError, match=r"placement\.locate:retracted"):
        walk.ask("placement.locate")
    assert walk.ask("placement.locate:held").states["placement"] == "held"
    assert walk.ask("robot.placement_changed").code == "internal_operation"


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


def test_unreadable_workflow_ends_with_2(tmp_path: Path) -> None:
    file = tmp_path / "no.toml"
    file.write_bytes(b"\xff")
    assert simulate(str(file)).exit_code == 2
    assert simulate(str(tmp_path / "none.toml")).exit_code == 2
