"""A written blueprint reads back as itself, whatever its texts hold."""

from __future__ import annotations

import tomllib
from pathlib import Path

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

import pcmrs
from pcmrs.fsm import parse_blueprint
from pcmrs.fsm.blueprint import (
    ActivitySpec,
    Blueprint,
    BranchSpec,
    Condition,
    MigrationSpec,
    OperationSpec,
    OutcomeSpec,
    ParentSpec,
    PropertySpec,
    RevocationSpec,
    SequenceSpec,
)
from pcmrs.fsm.files.dump import LONGEST_LINE, blueprint_toml
from pcmrs.fsm.files.load import content_hash, load_unexpanded
from pcmrs.fsm.files.sequence import expand
from tests.support.trials import examples
from tests.unit.fsm.arm_workflow import arm_blueprint
from tests.unit.fsm.files.pump_workflow import PUMP

WORKFLOWS = sorted((Path(pcmrs.__file__).parent / "workflows").glob("*.toml"))

TEXT = st.text(st.characters(exclude_categories=["Cs"]), max_size=20)

NAME = st.sampled_from(["a", "b1", "000", "*", "states", "operations", "parent", "a.b", 'q"', "x y", ""])

STATES = st.lists(NAME, max_size=3)

LONG = st.lists(NAME, max_size=60)

REQUIREMENT = st.dictionaries(NAME, STATES | LONG, max_size=3)

TARGET = NAME | st.dictionaries(NAME, NAME, max_size=3)

OUTCOME = st.builds(OutcomeSpec, to=TARGET, requires=REQUIREMENT)

ANYTHING = st.recursive(
    st.booleans() | st.integers(-(2**40), 2**40) | st.floats(allow_nan=False) | TEXT,
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(NAME, inner, max_size=3),
    max_leaves=8,
)

OPERATION = st.builds(
    OperationSpec,
    title=TEXT,
    from_=STATES | LONG,
    to=st.none() | TARGET,
    outcomes=st.dictionaries(NAME, OUTCOME, max_size=2),
    timeout_s=st.floats(0, 1e6),
    requires=REQUIREMENT,
    rio=st.booleans(),
    on_failure=st.none() | TARGET,
)

BRANCH = st.builds(
    BranchSpec,
    level=st.integers(1, 3),
    states=st.dictionaries(NAME, TEXT, max_size=3),
    sequence=st.none() | st.builds(SequenceSpec, count=st.integers(1, 3), perform=st.just({"steps": ["s"]})),
    operations=st.dictionaries(NAME, OPERATION, max_size=2),
    parent=st.none() | st.builds(ParentSpec, branch=NAME, start=NAME, compatible=REQUIREMENT),
    emits=st.dictionaries(NAME, NAME, max_size=3),
    activities=st.dictionaries(NAME, st.builds(ActivitySpec, run=TEXT, ended=NAME, moves=st.booleans()), max_size=2),
    revocations=st.lists(st.builds(RevocationSpec, by=STATES, from_=STATES, to=NAME), max_size=2),
)

CONDITION = st.builds(Condition, states=REQUIREMENT, running=STATES)

BLUEPRINT = st.builds(
    Blueprint,
    id=TEXT,
    version=TEXT,
    goal=REQUIREMENT,
    branches=st.dictionaries(NAME, BRANCH, max_size=3),
    properties=st.lists(st.builds(PropertySpec, id=TEXT, when=CONDITION, never=st.none() | CONDITION), max_size=2),
    migrations=st.lists(st.builds(MigrationSpec, version=TEXT, hash=TEXT, why=TEXT.filter(str.strip)), max_size=2),
    defaults=st.dictionaries(NAME, ANYTHING, max_size=3),
)


def read(text: str) -> Blueprint:
    return msgspec.convert(tomllib.loads(text), Blueprint)


@examples(80)
@given(BLUEPRINT)
def test_blueprint_is_read_back_as_written(blueprint: Blueprint) -> None:
    again = read(blueprint_toml(blueprint))
    assert again == blueprint
    # Equality of tables disregards order, but the first state is the start.
    assert [list(b.states) for b in again.branches.values()] == [list(b.states) for b in blueprint.branches.values()]
    assert list(again.branches) == list(blueprint.branches)


@pytest.mark.parametrize("path", WORKFLOWS, ids=lambda path: path.stem)
def test_shipped_workflows_read_back_as_themselves(path: Path) -> None:
    for blueprint in (load_unexpanded(path), expand(load_unexpanded(path))):
        text = blueprint_toml(msgspec.structs.replace(blueprint, hash="0" * 64), comment="One\n\ntwo")
        assert text.startswith("# One\n#\n# two\n")
        assert read(text) == blueprint
        assert content_hash(read(text)) == content_hash(blueprint)


def test_defaults_are_left_out_and_tables_fit_the_line() -> None:
    operation = OperationSpec(from_=["0"], to="1", requires={"robot": ["1"]})
    wide = {f"state_number_{i}": ["0", "1"] for i in range(9)}
    parent = ParentSpec(branch="robot", start="1", compatible=wide)
    branch = BranchSpec(states={"0": "off", "1": "on"}, operations={"go": operation}, parent=parent)
    text = blueprint_toml(Blueprint(id="x", version="1", branches={"b": branch}))
    assert '[branches.b.operations.go]\nfrom = ["0"]\nto = "1"\nrequires = { robot = ["1"] }\n' in text
    assert "[branches.b.parent.compatible]\nstate_number_0 = " in text
    assert max(map(len, text.splitlines())) <= LONGEST_LINE
    assert "timeout_s" not in text


def test_implied_keys_are_not_written_and_others_are() -> None:
    implied = parse_blueprint((PUMP % "affects_patient = true").encode())
    barred = parse_blueprint((PUMP % "blocked_when_latched = true").encode())
    assert "blocked_when_latched" not in blueprint_toml(implied)
    assert "blocked_when_latched = true" in blueprint_toml(barred)
    assert len({implied.hash, barred.hash}) == 2


def test_activities_are_read_back_as_written() -> None:
    written = blueprint_toml(arm_blueprint())
    assert "[branches.arm.activities]\nnear = {" in written
    assert parse_blueprint(written.encode()) == arm_blueprint()
