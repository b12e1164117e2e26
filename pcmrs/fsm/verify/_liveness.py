"""Liveness: deadlocks, goals that are out of reach, a latch that cannot be released, operations that cannot end."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cached_property

import numpy as np

from pcmrs.fsm.behaviour import line_of
from pcmrs.fsm.blueprint import OperationSpec, StageSpec
from pcmrs.fsm.finding import Finding
from pcmrs.fsm.verify._encoding import Batch, Mask
from pcmrs.fsm.verify._moments import Moments
from pcmrs.fsm.verify._relation import Relation
from pcmrs.fsm.verify._search import Progress, SearchBudget, states_leading_to
from pcmrs.fsm.verify._space import Operation, StateSpace
from pcmrs.fsm.verify._structure import path_of
from pcmrs.fsm.verify.decision import DecisionCase


class TimedOperations:
    """Analysis of a workflow whose operations take time.

    An operation is asked again when it ends, in the joint state at that time. Its locks keep the branches that it
    depended on when it began; only one that also reads other branches can be denied at its end. For all others
    nothing has to be searched.

    Args:
        space: The joint states.
        progress: Called regularly with the numbers of moments that have been examined and that are known.

    Attributes:
        work: Remaining budget of the searches.
    """

    def __init__(self, space: StateSpace, progress: Progress | None = None) -> None:
        self.space = space
        self.work = SearchBudget(space.limit, progress, len(space.reached))

    def moments(self, observed: frozenset[str]) -> Moments:
        """Return the moments that can occur while these operations are watched.

        Raises:
            SearchLimitError: There are too many of them.
        """
        return Moments(self.space, observed, self.work)

    @cached_property
    def strandable(self) -> list[str]:
        """Operations that might end where they are denied, as far as their locks show."""
        lasting = [operation for operation in self.space.operations if operation.spec.steps]
        return [operation.name for operation in lasting if _may_be_denied_at_its_end(operation)]


def stranded(moments: Moments, name: str) -> Iterator[Finding]:
    """Find a moment at which the one watched operation runs and none of its endings is allowed.

    Args:
        moments: The moments of this operation.
        name: The operation, ``branch.operation``.
    """
    code = moments.reached.first(moments.stranded)
    if code is not None:
        text = f"{name} cannot be concluded in {moments.describe_state(code)}: it is denied there, whatever its ending."
        yield Finding(code="cannot_conclude", text=text, path=path_of(name), commands=moments.path_to(code))


def _may_be_denied_at_its_end(operation: Operation) -> bool:
    """Return true if two joint states with the same states of its locked branches may differ in their answer to it."""
    accepted = [decision for decision in operation.known if decision.accepted]
    denied = [decision for decision in operation.known if not decision.accepted]
    return any(_alike(one, other) for one in accepted for other in denied)


def _alike(accepted: DecisionCase, denied: DecisionCase) -> bool:
    # Locked branches cannot change while the operation runs; only the others may differ between start and end.
    writes, reads = accepted.locks
    both = (writes | reads) & accepted.seen.keys() & denied.seen.keys()
    return all(accepted.seen[branch] == denied.seen[branch] for branch in both)


def deadlocks(space: StateSpace) -> Iterator[Finding]:
    """Find a joint state short of the goal in which a user may ask for nothing; device events do not count."""
    by_user = space.relation(lambda operation: not operation.spec.event)
    code = space.reached.first(lambda batch: ~_at_goal(space, batch) & ~by_user.mark(space.decided(batch)))
    if code is not None:
        text = f"No operation is accepted in {describe_state(space, code)}: add one that leads out of it, or a goal."
        yield _after(space, "deadlock", text, code)


def goals(space: StateSpace) -> Iterator[Finding]:
    """Find a goal that cannot be reached from the start, or no longer from a joint state.

    Only requests of users and declared endings count: users cannot rely on a fault, or wait for a device.
    """
    goal = space.blueprint.goal
    if not goal:
        return
    wanted = " and ".join(f"{branch} in {' or '.join(states)}" for branch, states in goal.items())
    seeds = space.reached.which(lambda batch: batch.matching(goal))
    open_ = states_leading_to(space.reached, seeds, space.leaving(space.intended))
    if not open_.has(space.reached.levels[0]).all():
        text = f"No sequence of commands that end as declared leads to the goal: {wanted}."
        yield Finding(code="goal_unreachable", text=text, path=("goal",))
        return
    code = space.reached.first(lambda batch: ~open_.has(batch.codes))
    if code is not None:
        text = (
            f"From {describe_state(space, code)} no commands that end as declared lead to the goal any more: {wanted}."
        )
        yield _after(space, "goal_lost", text, code)


def stages(space: StateSpace) -> Iterator[Finding]:
    """Find a joint state in which a stage belongs to the procedure and cannot be reached.

    Beside requests of users, only events count that a stage names: those are waited for.
    """
    guided = space.relation(lambda each: not each.spec.event or each.name in space.blueprint.guided, declared=True)
    for index, stage in enumerate(space.blueprint.declared_stages):
        code = _lost(space, stage, guided)
        if code is not None:
            text = (
                f"From {describe_state(space, code)} nothing that users are led through leads to the stage {stage.id}: "
            )
            text += "correct its `goal`, or say by `when` where it belongs to the procedure."
            yield Finding(code="stage_lost", text=text, path=("stage", str(index)), commands=space.path_to(code))


def _lost(space: StateSpace, stage: StageSpec, guided: Relation) -> int | None:
    """Return one of the nearest joint states from which a stage cannot be reached; None if there is none."""
    seeds = space.reached.which(lambda batch: batch.matching(stage.goal))
    open_ = states_leading_to(space.reached, seeds, space.leaving(guided))
    return space.reached.first(lambda batch: batch.matching(stage.when) & ~open_.has(batch.codes))


def releases(space: StateSpace) -> Iterator[Finding]:
    """Find a joint state in which a Stop could no longer be acknowledged by what the latch still allows."""
    blueprint = space.blueprint
    if not any(operation.spec.blocked_when_latched for operation in space.operations):
        return
    allowed = space.relation(lambda operation: _is_allowed_by_latch(operation.spec), declared=True)
    releasing = space.relation(lambda operation: operation.name in blueprint.unlatching, declared=True)
    seeds = space.reached.which(lambda batch: releasing.mark(space.decided(batch)))
    open_ = states_leading_to(space.reached, seeds, space.leaving(allowed))
    code = space.reached.first(lambda batch: ~open_.has(batch.codes))
    if code is not None:
        release = " or ".join(blueprint.unlatching)
        text = f"After a Stop in {describe_state(space, code)}, no operation that the latch allows leads to {release}."
        yield _after(space, "no_release", text, code)


def _is_allowed_by_latch(operation: OperationSpec) -> bool:
    return not (operation.event or operation.blocked_when_latched)


def describe_state(space: StateSpace, code: int) -> str:
    """Return a joint state in a line.

    Args:
        space: The joint states.
        code: Code of the joint state.
    """
    return line_of(space.encoding.decoded(code))


def _at_goal(space: StateSpace, batch: Batch) -> Mask:
    if not space.blueprint.goal:
        return np.zeros(len(batch.codes), dtype=np.bool_)
    return batch.matching(space.blueprint.goal)


def _after(space: StateSpace, code: str, text: str, state: int) -> Finding:
    way = space.path_to(state)
    return Finding(code=code, text=text, path=path_of(way[-1]) if way else ("branches",), commands=way)
