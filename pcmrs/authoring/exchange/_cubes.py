"""Short conditions on the states of several branches.

A cube names, for some branches, the states that they may be in; other branches may be in any state.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

Cube = dict[str, frozenset[str]]


def holds(cube: Cube, states: Mapping[str, str]) -> bool:
    """Return true if the cube covers a joint state.

    Args:
        cube: The cube.
        states: Branch to state, for at least the branches of the cube.
    """
    return all(states[branch] in allowed for branch, allowed in cube.items())


def cover(
    wanted: Sequence[Mapping[str, str]], unwanted: Sequence[Mapping[str, str]], branches: Iterable[str]
) -> list[Cube]:
    """Return few and short cubes that cover all of the wanted joint states and none of the unwanted ones.

    Greedy: from each wanted joint state that is not covered yet a cube grows until it would touch an
    unwanted one. Joint states in neither list do not matter.

    Args:
        wanted: Joint states to cover.
        unwanted: Joint states not to cover.
        branches: Branches that the cubes may name.
    """
    cubes: list[Cube] = []
    for states in wanted:
        if not any(holds(cube, states) for cube in cubes):
            cubes.append(_grow({b: frozenset({states[b]}) for b in branches}, wanted, unwanted))
    return cubes


def _grow(cube: Cube, wanted: Sequence[Mapping[str, str]], unwanted: Sequence[Mapping[str, str]]) -> Cube:
    for branch in list(cube):
        others = {key: allowed for key, allowed in cube.items() if key != branch}
        barred = {states[branch] for states in unwanted if holds(others, states)}
        allowed = frozenset(states[branch] for states in wanted if holds(others, states)) - barred
        cube = {**others, branch: allowed} if barred else others
    return cube


def merge(cubes: Iterable[Cube], domains: Mapping[str, Iterable[str]]) -> list[Cube]:
    """Return fewer cubes that cover exactly the same: those that differ in one branch only become one.

    Args:
        cubes: Cubes.
        domains: Branch to all its states.
    """
    full = {branch: frozenset(domain) for branch, domain in domains.items()}
    merged: list[Cube] = []
    for cube in cubes:
        grown = cube
        while (found := _first_joined(merged, grown, full)) is not None:
            index, grown = found
            del merged[index]
        merged.append(grown)
    return merged


def _first_joined(merged: Sequence[Cube], cube: Cube, full: Mapping[str, frozenset[str]]) -> tuple[int, Cube] | None:
    """Return the first of some cubes that can be joined with another, by its index, and both as one cube."""
    for index, other in enumerate(merged):
        joined = _joined(other, cube, full)
        if joined is not None:
            return index, joined
    return None


def _joined(one: Cube, other: Cube, full: Mapping[str, frozenset[str]]) -> Cube | None:
    """Return both as one cube, or None if that would cover more than both."""
    cube = one
    for branch, domain in full.items():
        allowed, others = one.get(branch, domain), other.get(branch, domain)
        if allowed != others:
            if cube is not one:
                return None
            cube = {**one, branch: allowed | others}
    return {branch: allowed for branch, allowed in cube.items() if allowed != full[branch]}
