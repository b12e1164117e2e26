"""What differs in behaviour between two blueprints: not how they are written, but what they answer.

Where one has a branch that the other lacks, joint states are compared without it.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Collection, Hashable, Iterator, Mapping
from typing import Any, Literal

import msgspec

from pcmrs.fsm.behaviour import MAX_JOINT_STATES, Answer, Joint, behaviour, endings, operations
from pcmrs.fsm.blueprint import Blueprint, OperationSpec
from pcmrs.fsm.closure import Change, Denial

Kind = Literal[
    "added", "removed", "changed", "reached", "unreached", "accepted", "rejected", "ending", "reason", "locks"
]

DECLARED = ("payload", "checks", "steps", "timeout_s", "motion", "iio", "event", "unlatches")
"""What an operation declares of its performance; all else shows in what it answers."""

Facet = tuple[str, Hashable]
"""One side of an answer, and what it is."""

Seen = dict[Joint, dict[str, frozenset[Hashable]]]
"""For each joint state, each facet of an operation's answers."""

BEGINNINGS: dict[Kind, str] = {
    "reached": "now also reached:",
    "unreached": "no longer reached:",
    "accepted": "now also accepted in",
    "rejected": "no longer accepted in",
    "ending": "leads elsewhere from",
    "reason": "rejected for another reason in",
    "locks": "waits for other branches in",
}


class Difference(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """One difference between an old and a new blueprint.

    Attributes:
        kind: What kind; ``reached`` and ``unreached`` are joint states, the others are of the `subject`.
        subject: ``branch``, ``branch.operation`` or ``branch.operation:ending``; empty for the whole workflow.
        text: The same for a person who reviews it.
        joint_states: In how many joint states.
        example: The first of them.
        old: What is so in the old one, where it can be said for the example.
        new: What is so in the new one.
    """

    kind: Kind
    subject: str
    text: str
    joint_states: int = 0
    example: dict[str, str] = {}
    old: str = ""
    new: str = ""


def compare(old: Blueprint, new: Blueprint, limit: int = MAX_JOINT_STATES) -> list[Difference]:
    """Everything that differs; empty when nobody who uses the workflow could tell them apart.

    Raises:
        BlueprintError: One of them has more than `limit` joint states.
    """
    return [*_declared(old, new), *_answered(old, new, limit)]


# -- what is declared --------------------------------------------------------------------------------------


def _declared(old: Blueprint, new: Blueprint) -> Iterator[Difference]:
    before, after = _declarations(old), _declarations(new)
    for subject in dict.fromkeys((*before, *after)):
        if subject not in before or subject not in after:
            kind: Kind = "added" if subject in after else "removed"
            if _owner(subject) not in before or _owner(subject) not in after:
                continue  # it came or went with its branch
            yield Difference(kind=kind, subject=subject, text=f"{subject}: {kind}")
            continue
        for key in dict.fromkeys((*before[subject], *after[subject])):
            was, now = before[subject].get(key), after[subject].get(key)
            if was != now:
                text = f"{subject or 'workflow'}: {key} changed from {was} to {now}"
                yield Difference(kind="changed", subject=subject, text=text, old=str(was), new=str(now))


def _owner(subject: str) -> str:
    """What a declared thing is part of."""
    return subject.rpartition(".")[0] if "." in subject else ""


def _declarations(blueprint: Blueprint) -> dict[str, dict[str, Any]]:
    """Everything declared, by its name: the workflow, its branches, and their states and operations."""
    found: dict[str, dict[str, Any]] = {"": {"start": blueprint.initial(), "defaults": blueprint.defaults}}
    for name, branch in blueprint.branches.items():
        found[name] = {"flags": branch.flags}
        found |= {f"{name}.[{state}]": {} for state in branch.states}
    for branch_name, operation, spec in operations(blueprint):
        found[f"{branch_name}.{operation}"] = _declaration(spec)
    return found


def _declaration(spec: OperationSpec) -> dict[str, Any]:
    return {"roles": sorted(set(spec.roles))} | {key: getattr(spec, key) for key in DECLARED}


# -- what is answered --------------------------------------------------------------------------------------


def _answered(old: Blueprint, new: Blueprint, limit: int) -> Iterator[Difference]:
    common = [branch for branch in old.branches if branch in new.branches]
    before, after = _seen(old, common, limit), _seen(new, common, limit)
    reached_before, reached_after = before.pop(""), after.pop("")
    for kind, joints, within in (
        ("reached", [joint for joint in reached_after if joint not in reached_before], reached_after),
        ("unreached", [joint for joint in reached_before if joint not in reached_after], reached_before),
    ):
        yield from _group(kind, "", common, joints, within)  # type: ignore[arg-type]
    both = [joint for joint in reached_before if joint in reached_after]
    for operation in before:
        if operation in after:
            yield from _operation(operation, common, both, before[operation], after[operation])


def _seen(blueprint: Blueprint, common: Collection[str], limit: int) -> dict[str, Seen]:
    """The facets of all answers of each operation; under "" every joint state that is reached."""
    places = [list(blueprint.branches).index(branch) for branch in common]
    specs = {f"{branch}.{operation}": spec for branch, operation, spec in operations(blueprint) if not spec.iio}
    found: dict[str, Seen] = {"": {}} | {operation: {} for operation in specs}
    for joint, answers in behaviour(blueprint, limit).items():
        part = tuple(joint[place] for place in places)
        found[""][part] = {}
        for operation, spec in specs.items():
            facets = found[operation].setdefault(part, {})
            for facet, value in _facets(spec, answers[operation], common):
                facets[facet] = facets.get(facet, frozenset()) | {value}
    return found


def _facets(spec: OperationSpec, said: Answer, common: Collection[str]) -> Iterator[Facet]:
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


def _operation(
    operation: str, common: list[str], both: list[Joint], before: Seen, after: Seen
) -> Iterator[Difference]:
    """Groups the joint states in which an operation is answered differently by how it differs."""
    groups: dict[tuple[Kind, str], list[Joint]] = defaultdict(list)
    for joint in both:
        for facet in _differing(before[joint], after[joint]):
            groups[facet].append(joint)
    for (kind, facet), joints in groups.items():
        subject = f"{operation}:{facet.removeprefix('ending ')}" if kind == "ending" else operation
        was, now = (seen[joints[0]].get(facet, frozenset()) for seen in (before, after))
        told = kind not in ("accepted", "rejected")
        said = (_said(was, now), _said(now, was)) if told else ("", "")
        yield from _group(kind, subject, common, joints, both, *said)


def _differing(was: Mapping[str, frozenset[Any]], now: Mapping[str, frozenset[Any]]) -> Iterator[tuple[Kind, str]]:
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


def _said(values: frozenset[Any], other: frozenset[Any]) -> str:
    """What a facet is, for a person: of changes, only what the other one lacks."""
    if not values:
        return "impossible"
    if len(values) == len(other) == 1:
        ((value,), (lacking,)) = values, other
        if isinstance(value, frozenset):
            return _worded(value - lacking)
    return " or ".join(sorted(_worded(value) for value in values))


def _worded(value: Any) -> str:
    if isinstance(value, str):
        return value
    if isinstance(value, tuple):
        writes, reads = (", ".join(sorted(branches)) or "nothing" for branches in value)
        return f"changes {writes}; needs {reads}"
    moves = sorted(f"{e.branch} {e.source}→{e.target}" + (f" by {e.kind}" * (e.kind != "operation")) for e in value)
    return ", ".join(moves) or "nothing more"


# -- how it is said ----------------------------------------------------------------------------------------


def _group(
    kind: Kind,
    subject: str,
    common: list[str],
    joints: list[Joint],
    within: Collection[Joint],
    old: str = "",
    new: str = "",
) -> Iterator[Difference]:
    if not joints:
        return
    example = dict(zip(common, joints[0], strict=True))
    count = f"{len(joints)} joint state{'s' * (len(joints) != 1)}"
    said = f" (was: {old}; now: {new})" if old or new else ""
    text = f"{subject or 'workflow'}: {BEGINNINGS[kind]} {count}{_where(common, joints, within)}{said}"
    yield Difference(
        kind=kind, subject=subject, text=text, joint_states=len(joints), example=example, old=old, new=new
    )


def _where(common: list[str], joints: list[Joint], within: Collection[Joint]) -> str:
    """Which joint states these are: by the states of single branches where that says it, else by an example."""
    columns = [set(column) for column in zip(*joints, strict=True)]
    everything = [set(column) for column in zip(*within, strict=True)]
    boxed = sum(all(state in column for state, column in zip(joint, columns, strict=True)) for joint in within)
    if boxed != len(joints):
        return ", e.g. " + " ".join(f"{branch}={state}" for branch, state in zip(common, joints[0], strict=True))
    narrow = [
        f"{branch}={'|'.join(sorted(states))}"
        for branch, states, possible in zip(common, columns, everything, strict=True)
        if states != possible
    ]
    return f": {' '.join(narrow) or 'all there are'}"
