"""Differences in behaviour between two blueprints: not how they are written, but how they answer.

If only one has a branch, joint states are compared without it. Answers are compared by facets: the aspects that can be
distinguished from outside.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Collection, Hashable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Literal

import msgspec

from pcmrs.fsm.behaviour import Joint, Ruling, behaviour, endings, line_of, operations
from pcmrs.fsm.blueprint import ActivitySpec, Blueprint, OperationSpec, PropertySpec
from pcmrs.fsm.closure import Change, Denial

__all__ = ["BlueprintDifference", "compare"]

FacetKind = Literal["accepted", "rejected", "ending", "reason", "locks"]

Facets = dict[str, frozenset[Any]]
"""``accepted``, ``reason``, ``locks`` and ``ending <name>``, each with all values that were seen."""

FacetsByState = dict[Joint, Facets]
"""The facets of an operation's answers in each joint state."""


def _facets_of(blueprint: Blueprint, common: Collection[str]) -> dict[str, FacetsByState]:
    """Return the facets of all answers of each operation; under "" every joint state that is reached.

    Args:
        blueprint: The workflow.
        common: Branches to compare.
    """
    places = [list(blueprint.branches).index(branch) for branch in common]
    specs = {f"{branch}.{operation}": spec for branch, operation, spec in operations(blueprint) if not spec.iio}
    found: dict[str, FacetsByState] = {operation: {} for operation in ("", *specs)}
    for joint, answers in behaviour(blueprint).items():
        part = tuple(joint[place] for place in places)
        found[""][part] = {}
        for operation, spec in specs.items():
            facets = found[operation].setdefault(part, {})
            for facet, value in _sides(spec, answers[operation], common):
                facets[facet] = facets.get(facet, frozenset()) | {value}
    return found


def _sides(spec: OperationSpec, answer: Ruling, common: Collection[str]) -> Iterator[tuple[str, Hashable]]:
    yield "accepted", not isinstance(answer, Denial)
    if isinstance(answer, Denial):
        yield "reason", answer.code
        return
    for ending, change in endings(spec, answer).items():
        yield f"ending {ending}", _consequence(change, common)
    yield "locks", (answer.writes & frozenset(common), answer.reads & frozenset(common))


def _consequence(change: Change | None, common: Collection[str]) -> Hashable:
    """Return the effect of a change on the branches that both have, in no order."""
    if change is None:
        return frozenset()
    return frozenset(effect for effect in change.effects if effect.branch in common)


def _differing_facets(
    was: Mapping[str, frozenset[Any]], now: Mapping[str, frozenset[Any]]
) -> Iterator[tuple[FacetKind, str]]:
    """Return the facets that differ, without those that only follow from another difference.

    Args:
        was: Facets in the old blueprint.
        now: Facets in the new blueprint.
    """
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


def _describe_facet(values: frozenset[Any], other: frozenset[Any]) -> str:
    """Return a facet in words; of changes, only those that the other blueprint lacks.

    Args:
        values: All values of the facet.
        other: Its values in the other blueprint.
    """
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


Kind = Literal["added", "removed", "changed", "reached", "unreached"] | FacetKind

DECLARED = (
    "payload", "checks", "steps", "timeout_s", "motion", "affects_patient", "blocked_when_latched", "irreversible",
    "allows_again", "iio", "event", "unlatches",
)  # fmt: skip
"""Keys of an operation that are compared as declared; all others show in its answers."""

BEGINNINGS: dict[Kind, str] = {
    "reached": "now also reached:",
    "unreached": "no longer reached:",
    "accepted": "now also accepted in",
    "rejected": "no longer accepted in",
    "ending": "leads elsewhere from",
    "reason": "rejected for another reason in",
    "locks": "waits for other branches in",
}


class BlueprintDifference(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """One difference between an old and a new blueprint.

    Attributes:
        kind: Kind of difference; ``reached`` and ``unreached`` are of joint states, the others of the `subject`.
        subject: ``branch``, ``branch.operation`` or ``branch.operation:ending``; empty for the whole workflow.
        text: The difference in words, for reviewers.
        joint_states: Number of joint states in which they differ.
        example: The first of them.
        old: Value in the old blueprint, if it can be given for the example.
        new: Value in the new blueprint.
    """

    kind: Kind
    subject: str
    text: str
    joint_states: int = 0
    example: dict[str, str] = {}
    old: str = ""
    new: str = ""


def compare(old: Blueprint, new: Blueprint) -> list[BlueprintDifference]:
    """Return all differences; empty if no user of the workflow could tell them apart.

    Args:
        old: The old blueprint.
        new: The new blueprint.

    Raises:
        BlueprintError: One of them has too many joint states to go through; see `behaviour`.
    """
    return [*_declared(old, new), *_answered(old, new)]


# -- what is declared --------------------------------------------------------------------------------------


def _declared(old: Blueprint, new: Blueprint) -> Iterator[BlueprintDifference]:
    before, after = _declarations(old), _declarations(new)
    for subject in dict.fromkeys((*before, *after)):
        if subject not in before or subject not in after:
            kind: Kind = "added" if subject in after else "removed"
            if _owner(subject) not in before or _owner(subject) not in after:
                continue  # added or removed with its branch
            yield BlueprintDifference(kind=kind, subject=subject, text=f"{subject}: {kind}")
            continue
        for key in dict.fromkeys((*before[subject], *after[subject])):
            was, now = before[subject].get(key), after[subject].get(key)
            if was != now:
                text = f"{subject or 'workflow'}: {key} changed from {was} to {now}"
                yield BlueprintDifference(kind="changed", subject=subject, text=text, old=str(was), new=str(now))


def _owner(subject: str) -> str:
    """Return the name of the declaration that contains a declaration."""
    return subject.rpartition(".")[0] if "." in subject else ""


def _declarations(blueprint: Blueprint) -> dict[str, dict[str, Any]]:
    """Return everything declared, by its name: workflow, properties, branches, and their states and operations."""
    found: dict[str, dict[str, Any]] = {"": {"defaults": blueprint.defaults, "goal": blueprint.goal}, "property": {}}
    found |= {f"property.{promise.id}": _promise(promise) for promise in blueprint.properties}
    for name, branch in blueprint.branches.items():
        found[name] = {"start": branch.start, "flags": branch.flags}
        found |= {f"{name}.timer {key}": msgspec.structs.asdict(timer) for key, timer in branch.timers.items()}
        found |= {f"{name}.[{state}]": _activity(branch.activities.get(state)) for state in branch.states}
    for branch_name, operation, spec in operations(blueprint):
        found[f"{branch_name}.{operation}"] = _declaration(spec)
    return found


def _activity(activity: ActivitySpec | None) -> dict[str, Any]:
    if activity is None:
        return {}
    return {"activity": activity.run, "ended by": activity.ended, "moves": activity.moves}


def _promise(promise: PropertySpec) -> dict[str, Any]:
    return {key: value for key, value in msgspec.structs.asdict(promise).items() if key not in ("id", "text")}


def _declaration(spec: OperationSpec) -> dict[str, Any]:
    return {"roles": sorted(set(spec.roles))} | {key: getattr(spec, key) for key in DECLARED}


# -- what is answered --------------------------------------------------------------------------------------


def _answered(old: Blueprint, new: Blueprint) -> Iterator[BlueprintDifference]:
    common = [branch for branch in old.branches if branch in new.branches]
    before, after = _facets_of(old, common), _facets_of(new, common)
    reached_before, reached_after = before.pop(""), after.pop("")
    gained = [joint for joint in reached_after if joint not in reached_before]
    lost = [joint for joint in reached_before if joint not in reached_after]
    if gained:
        yield _Space(common, reached_after).difference("reached", "", gained)
    if lost:
        yield _Space(common, reached_before).difference("unreached", "", lost)
    # Sorted, so that the example does not depend on which of the two is the old one.
    both = _Space(common, sorted(reached_before.keys() & reached_after.keys()))
    for operation in before:
        if operation in after:
            yield from _operation(operation, both, before[operation], after[operation])


@dataclass(frozen=True, slots=True)
class _Space:
    """Joint states in which two workflows are compared.

    Attributes:
        branches: Branches that both have.
        joints: All joint states of these branches.
    """

    branches: list[str]
    joints: Collection[Joint]

    def difference(
        self, kind: Kind, subject: str, joints: list[Joint], old: str = "", new: str = ""
    ) -> BlueprintDifference:
        """Return a difference in some of the joint states."""
        count = f"{len(joints)} joint state{'s' * (len(joints) != 1)}"
        values = f" (was: {old}; now: {new})" if old or new else ""
        text = f"{subject or 'workflow'}: {BEGINNINGS[kind]} {count}{self._where(joints)}{values}"
        example = dict(zip(self.branches, joints[0], strict=True))
        return BlueprintDifference(
            kind=kind, subject=subject, text=text, joint_states=len(joints), example=example, old=old, new=new
        )

    def _where(self, joints: list[Joint]) -> str:
        """Describe joint states: by the states of single branches if these suffice, else by an example."""
        columns, everything = ([set(column) for column in zip(*of, strict=True)] for of in (joints, self.joints))
        boxed = sum(all(map(set.__contains__, columns, joint)) for joint in self.joints)
        if boxed != len(joints):
            return f", e.g. {line_of(dict(zip(self.branches, joints[0], strict=True)))}"
        narrow = {
            branch: "|".join(sorted(states))
            for branch, states, possible in zip(self.branches, columns, everything, strict=True)
            if states != possible
        }
        return f": {line_of(narrow) or 'all there are'}"


def _operation(
    operation: str, both: _Space, before: FacetsByState, after: FacetsByState
) -> Iterator[BlueprintDifference]:
    """Group the joint states in which an operation is answered differently by how it differs."""
    groups: dict[tuple[FacetKind, str], list[Joint]] = defaultdict(list)
    for joint in both.joints:
        for difference in _differing_facets(before[joint], after[joint]):
            groups[difference].append(joint)
    for (kind, facet), joints in groups.items():
        subject = f"{operation}:{facet.removeprefix('ending ')}" if kind == "ending" else operation
        was, now = (seen[joints[0]].get(facet, frozenset()) for seen in (before, after))
        values = ("", "") if facet == "accepted" else (_describe_facet(was, now), _describe_facet(now, was))
        yield both.difference(kind, subject, joints, *values)
