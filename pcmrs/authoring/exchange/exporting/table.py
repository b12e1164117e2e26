"""Writes the transition table of a workflow for the reviewers of a procedure."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import msgspec

from pcmrs.fsm.blueprint import (
    START_OUTCOME,
    Blueprint,
    BranchSpec,
    OperationSpec,
    OutcomeSpec,
    Requirement,
    TransitionTarget,
    target_from,
)

__all__ = ["table"]

COLUMNS = ("branch", "operation", "from → to", "requires", "checks", "steps", "asked by", "calls")


def table(blueprint: Blueprint) -> str:
    """Return the operations of all branches as a Markdown table, a line for each way an operation can end."""
    rows = [row for name, branch in blueprint.branches.items() for row in _branch(name, branch)]
    lines = [COLUMNS, tuple("---" for _ in COLUMNS), *rows]
    text = "\n".join(f"| {' | '.join(line)} |" for line in lines)
    head = f"# {_cell(blueprint.title or blueprint.id)}\n\n{blueprint.id} {blueprint.version}{_origin(blueprint)}"
    return f"{head}\n\n{text}\n"


def _origin(blueprint: Blueprint) -> str:
    """Return how a language model has drafted the workflow; nothing for one that people have written."""
    given = blueprint.provenance
    if given is msgspec.UNSET:
        return ""
    text = f"Drafted by {given.model} on {given.date}, prompt {given.prompt}, protocol {given.protocol}"
    return f"\n\n{_cell(text)}"


def _branch(name: str, branch: BranchSpec) -> Iterator[tuple[str, ...]]:
    for key, operation in branch.operations.items():
        for number, (ending, spec) in enumerate({**operation.endings, **operation.unconfirmed}.items()):
            shown = key if ending == START_OUTCOME else f"{key}: {ending}"
            first = number == 0
            yield (
                f"{name} ({branch.level})" if first else "",
                f"{shown}{_marks(operation)}" if first else f"… {ending}",
                f"{_sources(operation)} → {_target(spec.to)}",
                _requirement({**operation.requires, **spec.requires}),
                ", ".join(operation.checks) if first else "",
                ", ".join(operation.steps) if first else "",
                _asked_by(operation) if first else "",
                ", ".join(_calls(branch, key, operation, spec)),
            )
    for state, activity in branch.activities.items():
        moves = " (moves)" if activity.moves else ""
        at_its_end = f"{activity.ended} when it ends"
        yield (name, f"activity{moves}", state, "", "", activity.run, "being in the state", at_its_end)
    for key, timer in branch.timers.items():
        restarts = timer.begins_again(name)
        posts = f"{timer.posts}; restarted by {', '.join(restarts)}" if restarts else timer.posts
        yield (name, f"timer {key}", ", ".join(timer.states), "", "", "", timer.when, posts)
    for rule in branch.revocations:
        moved = f"{', '.join(rule.from_)} → {rule.to}"
        yield (name, "revoked", moved, "", "", "", f"a change of {', '.join(rule.by)}", "")


def _marks(operation: OperationSpec) -> str:
    marks = {"RIO": operation.rio, "IIO": operation.iio, operation.motion: operation.motion != "none"}
    shown = [mark for mark, marked in marks.items() if marked]
    return f" ({', '.join(shown)})" if shown else ""


def _asked_by(operation: OperationSpec) -> str:
    if operation.iio:
        return "a child"
    return "a device" if operation.event else ", ".join(operation.roles) or "anyone"


def _calls(branch: BranchSpec, key: str, operation: OperationSpec, ending: OutcomeSpec) -> Iterator[str]:
    """Return the effects on other branches: set states, revocations elsewhere, and the parent's operations (Rule 2)."""
    yield from (f"{child} := {state}" for child, state in operation.sets.items())
    yield from (f"{revoked} revoked to {state}" for revoked, state in ending.diverted.items())
    ways = [(state, target_from(ending.to, state)) for state in branch.states if branch.valid_in(key, state)]
    targets = {target for source, target in ways if target != source or operation.signals}
    if branch.parent is not None:
        emitted = dict.fromkeys(branch.emits[state] for state in branch.states if state in targets)
        yield from (f"{branch.parent.branch}.{called}" for called in emitted)


def _sources(operation: OperationSpec) -> str:
    return "any" if operation.from_ == ["*"] else ", ".join(operation.from_)


def _target(to: TransitionTarget) -> str:
    return to if isinstance(to, str) else ", ".join(to.values())


def _requirement(requires: Requirement) -> str:
    return "; ".join(f"{branch} {_either(states)}" for branch, states in requires.items())


def _either(states: Iterable[str]) -> str:
    return " or ".join(states)


def _cell(text: str) -> str:
    return text.replace("|", "\\|").replace("\n", " ")
