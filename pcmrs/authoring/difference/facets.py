"""The sides of a workflow's answers that can be told apart from outside, and how two answers differ in them."""

from __future__ import annotations

from collections.abc import Collection, Hashable, Iterator, Mapping
from typing import Any, Literal

from pcmrs.fsm.behaviour import Joint, Ruling, behaviour, endings, operations
from pcmrs.fsm.blueprint import Blueprint, OperationSpec
from pcmrs.fsm.closure import Change, Denial

FacetKind = Literal["accepted", "rejected", "ending", "reason", "locks"]

Facets = dict[str, frozenset[Any]]
"""``accepted``, ``reason``, ``locks`` and ``ending <name>``, each with all that it was seen to be."""

Seen = dict[Joint, Facets]
"""The facets of an operation's answers in each joint state."""


def answers_seen(blueprint: Blueprint, common: Collection[str]) -> dict[str, Seen]:
    """The facets of all answers of each operation; under "" every joint state that is reached."""
    places = [list(blueprint.branches).index(branch) for branch in common]
    specs = {f"{branch}.{operation}": spec for branch, operation, spec in operations(blueprint) if not spec.iio}
    found: dict[str, Seen] = {operation: {} for operation in ("", *specs)}
    for joint, answers in behaviour(blueprint).items():
        part = tuple(joint[place] for place in places)
        found[""][part] = {}
        for operation, spec in specs.items():
            facets = found[operation].setdefault(part, {})
            for facet, value in _sides(spec, answers[operation], common):
                facets[facet] = facets.get(facet, frozenset()) | {value}
    return found


def _sides(spec: OperationSpec, said: Ruling, common: Collection[str]) -> Iterator[tuple[str, Hashable]]:
    yield "accepted", not isinstance(said, Denial)
    if isinstance(said, Denial):
        yield "reason", said.code
        return
    for ending, change in endings(spec, said).items():
        yield f"ending {ending}", _consequence(change, common)
    yield "locks", (said.writes & frozenset(common), said.reads & frozenset(common))


def _consequence(change: Change | None, common: Collection[str]) -> Hashable:
    """What a change does to the branches that both have, in no order."""
    if change is None:
        return frozenset()
    return frozenset(effect for effect in change.effects if effect.branch in common)


def differing(was: Mapping[str, frozenset[Any]], now: Mapping[str, frozenset[Any]]) -> Iterator[tuple[FacetKind, str]]:
    """The facets that differ, without those that only follow from another difference."""
    before, after = was["accepted"], now["accepted"]
    if before != after:
        yield "accepted" if sorted(after) > sorted(before) else "rejected", "accepted"
    if False in before & after and was["reason"] != now["reason"]:
        yield "reason", "reason"
    if True in before & after:
        facets = dict.fromkeys((*was, *now))
        ways = [facet for facet in facets if facet.startswith("ending ") and was.get(facet) != now.get(facet)]
        yield from (("ending", facet) for facet in ways)
        if not ways and was["locks"] != now["locks"]:
            yield "locks", "locks"


def worded(values: frozenset[Any], other: frozenset[Any]) -> str:
    """What a facet is, for a person: of changes, only what the other one lacks."""
    if not values:
        return "impossible"
    if len(values) == len(other) == 1:
        ((value,), (lacking,)) = values, other
        if isinstance(value, frozenset):
            return _phrase(value - lacking)
    return " or ".join(sorted(_phrase(value) for value in values))


def _phrase(value: Any) -> str:
    if isinstance(value, str):
        return value
    if isinstance(value, tuple):
        writes, reads = (", ".join(sorted(branches)) or "nothing" for branches in value)
        return f"changes {writes}; needs {reads}"
    moves = sorted(f"{e.branch} {e.source}→{e.target}" + (f" by {e.kind}" * (e.kind != "operation")) for e in value)
    return ", ".join(moves) or "nothing more"
