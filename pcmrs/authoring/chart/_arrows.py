"""Arrows inside one branch: operations with the same sources and target share an arrow."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal, NamedTuple

from pcmrs.fsm.blueprint import BranchSpec, OperationSpec, TransitionTarget, target_from

Kind = Literal["transition", "failure", "signal", "call", "revocation"]
"""Kind of a line: an operation, its failure, Rule 2, Rule 3, or a revocation."""


class StateRef(NamedTuple):
    """A state of a branch; an empty state means the whole branch."""

    branch: str
    state: str


@dataclass(frozen=True, slots=True)
class Arrow:
    """One arrow inside a branch.

    Attributes:
        kind: Kind of line; a `signal` is an operation that only a child branch calls.
        sources: Source states, in the branch's order; empty for all of them.
        target: Target state; a loop has it as its only source, other arrows never have it as a source.
        heading: Common part of all its labels, such as ``failed``; may be empty.
        labels: Operations, ``operation: outcome`` where outcomes are declared.
    """

    kind: Kind
    sources: tuple[str, ...]
    target: str
    heading: str
    labels: tuple[str, ...]

    @property
    def loops(self) -> bool:
        """It ends where it begins."""
        return self.sources == (self.target,)

    @property
    def words(self) -> list[str]:
        """Its caption in pieces that stay unbroken."""
        heading = [f"{self.heading}:"] if self.heading else []
        return [*heading, *(f"{label}," for label in self.labels[:-1]), self.labels[-1]]


def arrows(name: str, branch: BranchSpec) -> list[Arrow]:
    """Return all arrows inside a branch.

    An operation that fails, or whose end is unknown, and keeps its state has no arrow for that: it is the default
    of every operation. Nor has a signal whose target is reached already.

    Args:
        name: Name of the branch.
        branch: The branch.
    """
    grouped: dict[tuple[object, ...], list[_Ending]] = {}
    for ending in (*_endings(name, branch), *_revocations(branch)):
        grouped.setdefault(ending.group, []).append(ending)
    order = {state: number for number, state in enumerate(branch.states)}
    return [_merged(order, endings) for endings in grouped.values()]


def edges(name: str, branch: BranchSpec) -> list[Arrow]:
    """Return the arrows of a branch as edges: one source each, or none for all states, and its possible operations.

    Args:
        name: Name of the branch.
        branch: The branch.
    """
    grouped: dict[tuple[Kind, tuple[str, ...], str, str], list[str]] = {}
    for ending in (*_endings(name, branch), *_revocations(branch)):
        for source in ending.sources or (None,):
            sources = () if source is None else (source,)
            grouped.setdefault((ending.kind, sources, ending.target, ending.heading), []).append(ending.label)
    return [Arrow(*key, tuple(dict.fromkeys(labels))) for key, labels in grouped.items()]


class _Ending(NamedTuple):
    kind: Kind
    heading: str
    sources: tuple[str, ...]
    target: str
    label: str
    group: tuple[object, ...]


def _merged(order: Mapping[str, int], endings: list[_Ending]) -> Arrow:
    first = endings[0]
    sources = tuple(sorted({state for ending in endings for state in ending.sources}, key=order.__getitem__))
    labels = tuple(dict.fromkeys(ending.label for ending in endings))
    return Arrow(first.kind, sources, first.target, first.heading, labels)


def _endings(name: str, branch: BranchSpec) -> Iterator[_Ending]:
    for called, operation in branch.operations.items():
        mark = " (RIO)" * operation.rio + " (event)" * operation.event
        kind: Kind = "signal" if operation.iio else "transition"
        for outcome, ending in operation.endings.items():
            label = f"{called}: {outcome}{mark}" if operation.outcomes else f"{called}{mark}"
            possible = ending.requires.get(name, [])
            yield from _split(branch, operation, ending.to, kind, "", label, possible)
        for heading, target in _unconfirmed(operation):
            yield from _split(branch, operation, target, "failure", heading, called)


def _unconfirmed(operation: OperationSpec) -> Iterator[tuple[str, TransitionTarget]]:
    """Return the targets of an operation that does not end as declared, each with its heading."""
    failure, unknown = operation.on_failure, operation.on_unknown
    if failure is not None:
        yield "failed or end unknown" if failure == unknown else "failed", failure
    if unknown is not None and unknown != failure:
        yield "end unknown", unknown


def _split(
    branch: BranchSpec,
    operation: OperationSpec,
    target: TransitionTarget,
    kind: Kind,
    heading: str,
    label: str,
    possible: Sequence[str] = (),
) -> Iterator[_Ending]:
    """Return an ending's arrows: one for each target, and one more for the source that is the target."""
    if operation.from_ == ["*"] and isinstance(target, str) and not possible:
        yield _Ending(kind, heading, (), target, label, (kind, heading, (), target))
        return
    valid = [state for state in branch.states if operation.from_ == ["*"] or state in operation.from_]
    sources = [state for state in valid if state in possible] or valid
    leads = {state: target_from(target, state) for state in sources}
    for state in dict.fromkeys(leads.values()):
        others = tuple(source for source in sources if leads[source] == state != source)
        if others:
            # Failures that end in one state share an arrow: the other arrows of an operation show where it is valid.
            together = kind == "failure" and isinstance(target, str)
            yield _Ending(kind, heading, others, state, label, (kind, heading, None if together else others, state))
        if leads.get(state) == state and kind == "transition":
            yield _Ending(kind, heading, (state,), state, label, (kind, heading, (state,), state))


def _revocations(branch: BranchSpec) -> Iterator[_Ending]:
    for rule in branch.revocations:
        sources = tuple(state for state in branch.states if state in rule.from_ and state != rule.to)
        for by in rule.by if sources else []:
            yield _Ending("revocation", "revoked by", sources, rule.to, by, ("revocation", sources, rule.to))
