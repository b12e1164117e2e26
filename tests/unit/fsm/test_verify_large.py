"""A million joint states: all of them are found, and what is wrong in one of them too."""

from __future__ import annotations

import msgspec
import pytest

from pcmrs.fsm.blueprint import Blueprint, Condition, PropertySpec
from pcmrs.fsm.rules import check_rules
from pcmrs.fsm.verify import verify
from tests.unit.fsm.large_blueprints import entangled, free, promising


@pytest.mark.parametrize("blueprint", [free(20, 2), free(10, 4), entangled(10, 4)], ids=["20x2", "10x4", "entangled"])
@pytest.mark.nightly
def test_a_million_joint_states_are_searched(blueprint: Blueprint) -> None:
    calls: list[tuple[int, int]] = []
    found = verify(blueprint, progress=lambda looked_at, known: calls.append((looked_at, known)))
    assert list(check_rules(blueprint)) == []
    assert found.findings == []
    assert found.joint_states == 2**20
    assert calls == sorted(calls)
    assert calls[-1] == (2**20, 2**20)


def test_state_that_breaks_a_promise_is_found_by_shortest_path() -> None:
    """It is the only one of a million joint states."""
    everywhere = Condition(states={f"b{n}": ["s1"] for n in range(20)})
    blueprint = msgspec.structs.replace(free(20, 2), properties=[PropertySpec(id="never", never=everywhere)])
    found = verify(blueprint).findings
    assert [finding.code for finding in found] == ["property_violated"]
    assert sorted(found[0].commands or ()) == sorted(f"b{n}.on" for n in range(20))


@pytest.mark.nightly
def test_million_joint_states_are_twice_as_many_while_one_runs() -> None:
    """Each of four properties has its own, and all of them are part of the progress."""
    (alone,) = promising(20).properties
    four = [msgspec.structs.replace(alone, id=f"alone_{n}", when=Condition(running=[f"b{n}.on"])) for n in range(4)]
    blueprint = msgspec.structs.replace(promising(20), properties=four)
    calls: list[tuple[int, int]] = []
    assert verify(blueprint, progress=lambda looked_at, known: calls.append((looked_at, known))).findings == []
    assert calls == sorted(calls)
    assert calls[-1][0] == calls[-1][1] > 16 * 2**20
