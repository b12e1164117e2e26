"""Cubes against all joint states of three branches: what they cover is exact, and merging changes nothing."""

from __future__ import annotations

import itertools

from hypothesis import given
from hypothesis import strategies as st

from pcmrs.authoring.exchange._cubes import Cube, cover, holds, merge

DOMAINS = {"a": ("0", "1"), "b": ("0", "1", "2"), "c": ("x", "y", "z")}
EVERYWHERE = [dict(zip(DOMAINS, states, strict=True)) for states in itertools.product(*DOMAINS.values())]

joints = st.lists(st.sampled_from(EVERYWHERE), unique_by=lambda joint: tuple(joint.values()))
cubes = st.fixed_dictionaries(
    {},
    optional={
        branch: st.frozensets(st.sampled_from(domain), min_size=1, max_size=len(domain) - 1)
        for branch, domain in DOMAINS.items()
    },
)


def covered(some: list[Cube]) -> list[bool]:
    return [any(holds(cube, joint) for cube in some) for joint in EVERYWHERE]


@given(joints, st.randoms(use_true_random=False))
def test_a_cover_holds_all_wanted_and_no_unwanted_states(wanted: list[dict[str, str]], rng: object) -> None:
    """States that are in neither list do not matter."""
    others = [joint for joint in EVERYWHERE if joint not in wanted]
    unwanted = others[::2]
    found = cover(wanted, unwanted, DOMAINS)
    assert all(any(holds(cube, joint) for cube in found) for joint in wanted)
    assert not any(holds(cube, joint) for cube in found for joint in unwanted)
    assert len(found) <= len(wanted)


def test_without_unwanted_states_one_cube_names_nothing() -> None:
    assert cover(EVERYWHERE[:5], [], DOMAINS) == [{}]


@given(st.lists(cubes, max_size=6))
def test_merged_cubes_cover_the_same_and_are_no_more(some: list[Cube]) -> None:
    merged = merge(some, DOMAINS)
    assert covered(merged) == covered(some)
    assert len(merged) <= len(some)


def test_all_states_of_a_branch_are_no_condition() -> None:
    """In whatever order they come."""
    for states in itertools.permutations(DOMAINS["b"]):
        parts = [{"a": frozenset({"1"}), "b": frozenset({state})} for state in states]
        assert merge(parts, DOMAINS) == [{"a": frozenset({"1"})}]
    assert merge([{}, {"a": frozenset({"0"})}], DOMAINS) == [{}]
