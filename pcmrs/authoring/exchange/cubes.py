"""Conditions on the states of several branches, made short.

A cube says of some branches which states they may be in; branches it does not name may be in any.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

Cube = dict[str, frozenset[str]]


def holds(cube: Cube, states: Mapping[str, str]) -> bool:
    """Whether the cube covers a joint state that names at least its branches."""
    return all(states[branch] in allowed for branch, allowed in cube.items())


def cover(
    wanted: Sequence[Mapping[str, str]], unwanted: Sequence[Mapping[str, str]], branches: Iterable[str]
) -> list[Cube]:
    """Few and short cubes of some branches that cover all of the wanted joint states and none of the unwanted ones.

    Greedy: from each wanted joint state that is not covered yet a cube grows until it would touch an
    unwanted one. Joint states in neither list do not matter.
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
    """Fewer cubes that cover exactly the same: those that differ in one branch only become one."""
    merged: list[Cube] = []
    for cube in cubes:
        grown = cube
        while (other := next((m for m in merged if _joined(m, grown, domains) is not None), None)) is not None:
            grown = _joined(other, grown, domains) or {}
            merged.remove(other)
        merged.append(grown)
    return merged


def _joined(one: Cube, other: Cube, domains: Mapping[str, Iterable[str]]) -> Cube | None:
    """Both as one cube, or None when that would cover more than both."""
    full = {branch: frozenset(domain) for branch, domain in domains.items()}
    differing = [b for b in full if one.get(b, full[b]) != other.get(b, full[b])]
    if len(differing) > 1:
        return None
    cube = dict(one)
    for branch in differing:
        cube[branch] = one.get(branch, full[branch]) | other.get(branch, full[branch])
    return {branch: allowed for branch, allowed in cube.items() if allowed != full[branch]}
