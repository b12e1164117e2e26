"""Simulated walks: offered commands are accepted, all others refused, and everything can be taken back."""

from __future__ import annotations

from random import Random

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pcmrs.authoring.trial.session import SimulationSession
from pcmrs.errors import RefusalError
from pcmrs.fsm import Blueprint
from tests.support.ratms_oracle import INITIAL, Joint, all_operations, as_dict, expected
from tests.support.shipped import shipped_blueprint
from tests.support.trials import examples
from tests.unit.fsm.random_blueprints import blueprints

RATMS = shipped_blueprint("ratms")


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
