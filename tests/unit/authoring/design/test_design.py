"""From step tables to blueprints: the paper's example, random tables, and any bytes."""

from __future__ import annotations

from random import Random
from typing import Any

import pytest
import tomli_w
from hypothesis import given
from hypothesis import strategies as st

from pcmrs.authoring.design import Design, design
from pcmrs.fsm import Blueprint, Closure, Engine, flags_of, parse_blueprint
from tests.support.shipped import shipped_blueprint
from tests.support.trials import examples
from tests.unit.authoring.design.designed_tables import RANDOMS, Joint, designed, endings
from tests.unit.authoring.design.step_table_oracle import Model, random_table
from tests.unit.authoring.design.step_tables import RATMS_STEPS, blueprint_of

CLEARED_BEFORE = {("registration", "clear_landmarks", "000"), ("toolplan", "clear", "0")}
"""What ratms.toml also accepts where nothing is there to be cleared."""


def accepted(engine: Engine, branches: list[str]) -> dict[tuple[str, ...], dict[tuple[str, str], set[tuple[str, ...]]]]:
    """For each reachable joint state, where its accepted operations lead; all by the states of some branches only."""
    found: dict[tuple[str, ...], dict[tuple[str, str], set[tuple[str, ...]]]] = {}
    waiting, seen = [engine.joint()], set()
    while waiting:
        joint = waiting.pop()
        if tuple(joint.values()) in seen:
            continue
        seen.add(tuple(joint.values()))
        here = found.setdefault(tuple(joint[branch] for branch in branches), {})
        for branch, spec in engine.blueprint.branches.items():
            for operation in (name for name, each in spec.operations.items() if not each.iio):
                engine.place(joint)
                answer = engine.ask(branch, operation)
                if isinstance(answer, Closure):
                    waiting += [dict(change.states) for change in answer.outcomes.values()]
                    ends = {tuple(change.states[each] for each in branches) for change in answer.outcomes.values()}
                    here.setdefault((branch, operation), set()).update(ends)
    return found


def test_the_papers_table_becomes_what_was_written_by_hand() -> None:
    branches = ["registration", "digitization", "toolplan"]
    by_hand = accepted(Engine(shipped_blueprint("ratms")), branches)
    designed = accepted(Engine(blueprint_of(RATMS_STEPS)), branches)
    assert set(designed) == set(by_hand)
    common = {operation for here in designed.values() for operation in here}
    assert len(common) == 13
    for joint, operations in by_hand.items():
        states = dict(zip(branches, joint, strict=True))
        ends = {key: value for key, value in operations.items() if key in common}
        for branch, operation, state in CLEARED_BEFORE:
            if states[branch] == state:
                del ends[branch, operation]
        assert designed[joint] == ends, joint


ANY_STEP = st.fixed_dictionaries(
    {"name": st.sampled_from(["a", "b", "c", "class", ""]), "operation": st.sampled_from(["go", "do", "reinit", "ö"])},
    optional={
        "depends_on": st.lists(st.sampled_from(["a", "b", "c"]), max_size=2),
        "reopened_by": st.lists(st.sampled_from(["clear", "go", "x.y"]), max_size=2),
        "branch": st.sampled_from(["", "one", "two", "b-b"]),
        "timeout_s": st.floats(),
        "refined_by": st.fixed_dictionaries(
            {"branch": st.sampled_from(["one", "three", "a"])},
            optional={"points": st.integers(-1, 3) | st.lists(st.sampled_from(["p", "done", "q"]), max_size=2)},
        ),
        "steps": st.just(["s"]),
        "moves": st.sampled_from([True, False, "retreat"]),
        "affects_patient": st.booleans(),
        "irreversible": st.booleans(),
        "confirm": st.booleans(),
    },
)
MUTATION = st.tuples(st.integers(0, len(RATMS_STEPS)), st.integers(0, 12), st.binary(max_size=6))


def check_answer(result: Design) -> None:
    assert bool(result.text) != bool(result.findings)
    for finding in result.findings:
        assert finding.line >= 1, str(finding)
        assert finding.file == "steps"
    if result.text:
        assert parse_blueprint(result.text.encode()).branches


@examples(150)
@given(st.lists(ANY_STEP, max_size=4), st.text(max_size=3), st.text(max_size=3))
def test_any_table_ends_in_a_sound_blueprint_or_findings(steps: list[Any], name: str, version: str) -> None:
    check_answer(design(tomli_w.dumps({"id": name, "version": version, "steps": steps}).encode(errors="replace")))


@examples(40)
@given(st.lists(MUTATION, min_size=1, max_size=3))
def test_any_bytes_end_in_a_sound_blueprint_or_findings(mutations: list[tuple[int, int, bytes]]) -> None:
    raw = RATMS_STEPS
    for place, length, new in mutations:
        raw = raw[:place] + new + raw[place + length :]
    check_answer(design(raw))


def test_a_number_of_too_many_digits_has_its_place() -> None:
    (finding,) = design(b'id = "x"\nversion = ' + b"1" * 5000 + b"\n").findings
    assert (finding.code, finding.line, finding.column) == ("not_toml", 2, 11)
    assert finding.text == "This is not TOML: a number has over 4300 digits."


def done_in(model: Model, flags: dict[str, bool]) -> set[str]:
    return {name for name, step in model.steps.items() if not step.below and flags[name]}


def expected(model: Model, done: set[str], spec_flags: list[str], operation: str, outcome: str) -> set[str] | None:
    return model.reinit(done, spec_flags) if operation == "reinit" else model.command(done, operation, outcome)


def started_by_rule_3(blueprint: Blueprint, model: Model, branch: str, before: Joint, after: Joint) -> set[str]:
    """Steps of the branches that start where a direct change of `branch` has led."""
    if before[branch] == after[branch]:
        return set()
    starting = {
        name
        for name, spec in blueprint.branches.items()
        if spec.parent and (spec.parent.branch, spec.parent.start) == (branch, after[branch])
    }
    refined = (step for step in model.steps.values() if f"inside_{step.name}" in starting)
    return set().union(*(step.leaves() for step in refined))


def begun(blueprint: Blueprint, joint: Joint) -> bool:
    """Whether a refinement is neither at its start nor complete."""
    return any(b.level > 1 and len(set(joint[name])) > 1 for name, b in blueprint.branches.items())


@pytest.mark.parametrize(("levels", "steps"), [(1, 5), (2, 3), (3, 2)])
@examples(15)
@given(rng=RANDOMS)
def test_a_table_does_what_a_set_of_steps_does(levels: int, steps: int, rng: Random) -> None:
    """Refused otherwise is only what would leave behind something that has begun."""
    table = random_table(rng, levels=levels, steps=steps)
    _, blueprint = designed(table)
    model = Model(table)
    for joint, branch, operation, after in endings(Engine(blueprint)):
        done = done_in(model, flags_of(blueprint, joint))
        refused = after is None and blueprint.branches[branch].operations[operation].requires
        if refused and begun(blueprint, joint):
            continue
        for outcome, states in (after or {"": {}}).items():
            wanted = expected(model, done, blueprint.branches[branch].flags, operation, outcome)
            if after is None or wanted is None:
                assert (after is None) == (wanted is None), (table, joint, branch, operation)
                continue
            found = done_in(model, flags_of(blueprint, states))
            lost = started_by_rule_3(blueprint, model, branch, joint, states)
            assert wanted - lost <= found <= wanted, (table, joint, branch, operation, outcome)
