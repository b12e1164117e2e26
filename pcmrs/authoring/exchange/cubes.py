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
    merged: list[Cube] = []
    for cube in cubes:
        grown = cube
        while (other := next((m for m in merged if _joined(m, grown, domains) is not None), None)) is not None:
            grown = _joined(other, grown, domains) or {}
            merged.remove(other)
        merged.append(grown)
    return merged


def _joined(one: Cube, other: Cube, domains: Mapping[str, Iterable[str]]) -> Cube | None:
    """Return both as one cube, or None if that would cover more than both."""
    full = {branch: frozenset(domain) for branch, domain in domains.items()}
    differing = [b for b in full if one.get(b, full[b]) != other.get(b, full[b])]
    if len(differing) > 1:
        return None
    cube = dict(one)
    for branch in differing:
        cube[branch] = one.get(branch, full[branch]) | other.get(branch, full[branch])
    return {branch: allowed for branch, allowed in cube.items() if allowed != full[branch]}
