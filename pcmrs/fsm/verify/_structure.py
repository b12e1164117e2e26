"""Findings that follow from the decisions alone: cascades, determinism, and unused states and operations."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from itertools import combinations

import numpy as np

from pcmrs.fsm.finding import Finding
from pcmrs.fsm.verify._space import Operation, StateSpace
from pcmrs.fsm.verify.decision import DecisionCase

UNSOUND = {
    "cascade_too_long": (
        "endless_cascade",
        "triggers an endless cascade of changes: revocations must not undo each other.",
    ),
    "no_outcome": ("no_outcome", "is accepted, but cannot end in any declared way: add to its `requires` or outcomes."),
}
"""Denials that must not occur in any joint state, and the findings that report them."""

INCOMPLETE = {code for code, _ in UNSOUND.values()}
"""Findings after which the search is incomplete: an unreached state may only lie behind a broken operation."""


def denials(space: StateSpace) -> Iterator[Finding]:
    """Find operations that trigger an endless cascade, or that can begin but not end."""
    for operation, decision in _first_of_each(space, lambda found: found.denied in UNSOUND):
        code, text = UNSOUND[decision.denied or ""]
        yield _shown(space, operation, decision, code, f"{operation.name} {text}")


def order(space: StateSpace) -> Iterator[Finding]:
    """Find operations whose closure depends on the order of the branches in the file."""
    for operation, decision in _first_of_each(space, lambda found: found.ordered):
        text = (
            f"{operation.name} has another effect if the branches of the file are in another order: "
            "let at most one revocation or signal apply to each branch it touches."
        )
        yield _shown(space, operation, decision, "order_dependent", text)


def activities(space: StateSpace) -> Iterator[Finding]:
    """Find activities that may end by themselves where the operation that leaves their state is denied."""
    for operation in space.operations:
        declared = space.blueprint.branches[operation.branch].activities
        ending = {state for state, activity in declared.items() if activity.ended == operation.operation}
        denied = {
            decision.seen[operation.branch]: decision
            for decision in operation.known
            if not decision.accepted and decision.seen[operation.branch] in ending
        }
        for state, decision in denied.items():
            text = f"The activity {declared[state].run} of {operation.branch} {state} may end by itself where "
            text += f"{operation.operation} is denied: that operation must never be refused in that state."
            path, way = ("branches", operation.branch, "activities", state), space.path_to(space.nearest(decision))
            yield Finding(code="activity_stuck", text=text, path=path, commands=way)


def timers(space: StateSpace) -> Iterator[Finding]:
    """Find timers that may expire where the event that they post is denied: nobody would notice."""
    for operation in space.operations:
        branch = space.blueprint.branches[operation.branch]
        for name, timer in branch.timers.items():
            if timer.posts != operation.operation:
                continue
            stuck = (each for each in operation.known if each.seen[operation.branch] in timer.states)
            decision = next((each for each in stuck if not each.accepted), None)
            if decision is not None:
                text = f"The timer {name} of {operation.branch} {decision.seen[operation.branch]} may expire where "
                text += f"{operation.operation} is denied: that operation must never be refused in that state."
                path, way = ("branches", operation.branch, "timers", name), space.path_to(space.nearest(decision))
                yield Finding(code="timer_stuck", text=text, path=path, commands=way)


def revocations(space: StateSpace) -> Iterator[Finding]:
    """Find revocations of one branch that hold at once and disagree; the file alone shows it."""
    for name, branch in space.blueprint.branches.items():
        for (_, one), (second, other) in combinations(enumerate(branch.revocations), 2):
            # Two revocations clash only if one change triggers both of them in one state.
            by, states = sorted({*one.by} & {*other.by}), sorted({*one.from_} & {*other.from_})
            if by and states and one.to != other.to:
                text = f"A change of {by[0]} takes {name} from {states[0]} to {one.to} and to {other.to}: keep one."
                path = ("branches", name, "revocations", str(second))
                yield Finding(code="ambiguous_revocation", text=text, path=path)


def unused(space: StateSpace) -> Iterator[Finding]:
    """Find states that no branch enters, and operations that are never accepted or never called."""
    for digit, (name, states) in enumerate(zip(space.encoding.names, space.encoding.values, strict=True)):
        seen = np.zeros(len(states), dtype=np.bool_)
        for batch in space.reached.batches():
            seen[batch.digits[digit]] = True
        for state in (state for state, found in zip(states, seen, strict=True) if not found):
            text = f"No command takes {name} to {state}: let an operation lead there, or leave the state out."
            yield Finding(code="unreachable_state", text=text, path=("branches", name, "states", state))
    yield from _unaccepted(space)
    yield from _uncalled(space)


def path_of(command: str) -> tuple[str, ...]:
    """Return the path, in the blueprint, of the operation of a command."""
    branch, operation = command.partition(":")[0].split(".")
    return ("branches", branch, "operations", operation)


def _unaccepted(space: StateSpace) -> Iterator[Finding]:
    for operation in space.operations:
        if not any(decision.accepted for decision in operation.known):
            text = f"{operation.name} is accepted in none of the {len(space.reached)} joint states: see its `requires`."
            yield Finding(code="never_accepted", text=text, path=path_of(operation.name))


def _uncalled(space: StateSpace) -> Iterator[Finding]:
    called = frozenset[tuple[str, str]]().union(*(decision.calls for _, decision in space.decisions()))
    for name, branch in space.blueprint.branches.items():
        for operation, spec in branch.operations.items():
            if spec.iio and (name, operation) not in called:
                text = f"No change of a child calls {name}.{operation}: see the `emits` of the branches below {name}."
                yield Finding(code="never_called", text=text, path=("branches", name, "operations", operation))


def _first_of_each(
    space: StateSpace, wanted: Callable[[DecisionCase], bool]
) -> Iterator[tuple[Operation, DecisionCase]]:
    """Return one wanted decision of each operation that has one."""
    for operation in space.operations:
        yield from ((operation, decision) for decision in [*filter(wanted, operation.known)][:1])


def _shown(space: StateSpace, operation: Operation, decision: DecisionCase, code: str, text: str) -> Finding:
    commands = (*space.path_to(space.nearest(decision)), operation.name)
    return Finding(code=code, text=text, path=path_of(operation.name), commands=commands)
