"""The vectorised search against a search that does it one joint state at a time."""

from __future__ import annotations

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pcmrs.fsm.behaviour import branch_states, endings, joint_of
from pcmrs.fsm.blueprint import Blueprint, RevocationSpec
from pcmrs.fsm.closure import Closure, close
from pcmrs.fsm.verify import space, verify
from pcmrs.fsm.verify.encoding import Batch, Encoding
from pcmrs.fsm.verify.search import MAX_BITMAP, states_leading_to, visited
from pcmrs.fsm.verify.space import Space
from tests.support.trials import examples
from tests.unit.fsm.large_blueprints import free
from tests.unit.fsm.random_blueprints import blueprints

Joint = tuple[str, ...]


def successors(blueprint: Blueprint, joint: Joint) -> dict[Joint, int]:
    """How often each joint state follows on `joint`, worked out with nothing but `answer`."""
    found: dict[Joint, int] = {}
    states = branch_states(blueprint, joint)
    for branch, spec in blueprint.branches.items():
        for operation, declared in spec.operations.items():
            closure = close(blueprint, states, branch, operation)
            if isinstance(closure, Closure) and not declared.iio:
                for change in endings(declared, closure).values():
                    after = joint if change is None else joint_of(blueprint, change.states)
                    found[after] = found.get(after, 0) + 1
    return found


def levels(blueprint: Blueprint) -> dict[Joint, int]:
    """Every reachable joint state and the length of the shortest way to it."""
    start = joint_of(blueprint, blueprint.initial())
    found, waiting = {start: 0}, [start]
    for joint in waiting:
        for after in successors(blueprint, joint):
            if after not in found:
                found[after] = found[joint] + 1
                waiting.append(after)
    return found


@examples(60)
@given(blueprints())
@pytest.mark.nightly
def test_search_finds_each_joint_state_on_its_level(blueprint: Blueprint) -> None:
    """Every transition is counted."""
    expected = levels(blueprint)
    space = Space(blueprint, 10_000)
    found = {
        joint_of(blueprint, space.encoding.decoded(int(code))): length
        for length, level in enumerate(space.reached.levels)
        for code in level
    }
    assert found == expected
    assert space.taken == sum(sum(successors(blueprint, joint).values()) for joint in expected)


@examples(40)
@given(blueprints(), st.data())
@pytest.mark.nightly
def test_the_way_back_is_the_way_there(blueprint: Blueprint, data: st.DataObject) -> None:
    space = Space(blueprint, 10_000)
    reached = levels(blueprint)
    goal = data.draw(st.sampled_from(list(reached)))
    code = space.encoding.code(branch_states(blueprint, goal))
    known = states_leading_to(space.reached, np.array([code]), space.transitions)
    for joint in reached:
        expected = goal in _from(blueprint, joint)
        own = np.array([space.encoding.code(branch_states(blueprint, joint))])
        assert bool(known.has(own)[0]) == expected


def _from(blueprint: Blueprint, joint: Joint) -> set[Joint]:
    found, waiting = {joint}, [joint]
    for each in waiting:
        new = set(successors(blueprint, each)) - found
        found |= new
        waiting.extend(new)
    return found


@given(st.lists(st.lists(st.integers(0, 10**15), unique=True), max_size=30), st.booleans())
def test_a_set_of_codes_is_a_set(batches: list[list[int]], sparse: bool) -> None:
    modulus = 10**15 if sparse else 1000
    known, expected = visited(MAX_BITMAP + 1 if sparse else modulus), set[int]()
    for batch in batches:
        codes = sorted({code % modulus for code in batch})
        new = known.add(np.array(codes, dtype=np.int64))
        assert sorted(new.tolist()) == sorted(set(codes) - expected)
        expected |= set(codes)
        assert known.has(np.array(codes, dtype=np.int64)).all()


@given(st.lists(st.integers(1, 5), min_size=1, max_size=8), st.data())
def test_a_code_means_the_combination_it_was_made_of(sizes: list[int], data: st.DataObject) -> None:
    encoding = Encoding({f"b{n}": [str(value) for value in range(size)] for n, size in enumerate(sizes)})
    values = {
        name: data.draw(st.sampled_from(taken)) for name, taken in zip(encoding.names, encoding.values, strict=True)
    }
    code = encoding.code(values)
    assert 0 <= code < encoding.combinations
    assert encoding.decoded(code) == values


@pytest.mark.parametrize("limit", [1, 2, 3])
def test_search_beyond_the_limit_reports_only_that(limit: int) -> None:
    blueprint = free(4, 2)
    found = verify(blueprint, limit=limit).findings
    assert [finding.code for finding in found] == ["too_many_states"]
    assert str(limit) in found[0].text


@pytest.mark.parametrize("branches", [63, 1500])
def test_more_combinations_than_an_integer_holds_are_refused(branches: int) -> None:
    (finding,) = verify(free(branches, 2)).findings
    assert finding.code == "too_many_states"
    assert "more than 2^62 combinations" in finding.text


@pytest.mark.nightly
def test_many_branches_with_a_single_state_take_no_decisions() -> None:
    """Each of them is looked at by the revocations of all others."""
    rules = [RevocationSpec(by=[f"b{n + 1}"], from_=["s0"], to="s0") for n in range(199)]
    branches = free(200, 1).branches
    tied = {
        name: msgspec.structs.replace(branch, revocations=[rule])
        for (name, branch), rule in zip(branches.items(), rules, strict=False)
    }
    blueprint = Blueprint(id="still", version="1.0.0", branches=branches | tied, goal={"b0": ["s0"]})
    assert verify(blueprint).joint_states == 1


def test_commands_that_depend_on_too_much_are_refused_early(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """One branch revokes all others: each of its commands depends on everything at once."""
    monkeypatch.setattr(space, "MAX_DECISIONS", 300)
    branches = free(20, 2).branches
    rule = RevocationSpec(by=["b0"], from_=["s1"], to="s0")
    revoked = {name: msgspec.structs.replace(branch, revocations=[rule]) for name, branch in branches.items()}
    blueprint = Blueprint(id="star", version="1.0.0", branches={**revoked, "b0": branches["b0"]})
    found = verify(blueprint).findings
    assert [finding.code for finding in found] == ["too_many_states"]
    assert "depend on too many combinations" in found[0].text


@pytest.mark.parametrize("size", [2, 256, 257, 65_536, 65_537, 70_000])
def test_a_digit_holds_every_value_of_a_branch(size: int) -> None:
    encoding = Encoding({"first": [str(value) for value in range(size)], "second": ["a", "b"]})
    states = [{"first": str(value), "second": "b"} for value in (0, size // 2, size - 1)]
    batch = Batch(encoding, np.array([encoding.code(state) for state in states]))
    assert batch.digit(0).tolist() == [0, size // 2, size - 1]
    assert [encoding.decoded(int(code)) for code in batch.codes] == states
