"""The refinement of a step, as the branch above sees it: its start, its complete state, and those in between."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from pcmrs.authoring.design._grouping import StepGroup, UndesignableError, group
from pcmrs.authoring.design._hazards import hazard_of
from pcmrs.authoring.design._order import Order
from pcmrs.authoring.design._safety import CONNECTED, ROBOT, UNCONNECTED
from pcmrs.authoring.design.tables import ActionSpec, RefinementSpec, StepSpec
from pcmrs.fsm.blueprint import Blueprint, BranchSpec, ParentSpec, Requirement, SequenceSpec
from pcmrs.fsm.files.sequence import DONE, SequenceError, expand
from pcmrs.fsm.finding import Finding, Path


@dataclass(frozen=True, slots=True)
class Refinement:
    """A branch of level N+1.

    Attributes:
        name: Name of the branch.
        title: Its title.
        step: Index of the step that it refines.
        group: Its steps, or None for a refinement by
        sequence: points that are performed in order.
        states: All its states, the start first.
        complete: The state in which the refined step is achieved.
        below: Refinements of the refinement's steps.
    """

    name: str
    title: str
    step: int
    group: StepGroup | None
    sequence: SequenceSpec | None
    states: tuple[str, ...]
    complete: str
    below: tuple[Refinement, ...] = ()

    @property
    def start(self) -> str:
        """Its starting state."""
        return self.states[0]

    @property
    def partial(self) -> list[str]:
        """States in which it has begun and is not complete."""
        return [state for state in self.states[1:] if state != self.complete]

    def subtree(self) -> Iterator[Refinement]:
        """Return this refinement and all below it."""
        yield self
        for each in self.below:
            yield from each.subtree()

    def calm(self) -> Requirement:
        """Return the requirement that nothing has begun in it or below it without being complete."""
        return {each.name: [each.start, each.complete] for each in self.subtree() if each.partial}


def refinements_of(owner: StepGroup, paths: Mapping[str, Path]) -> list[Refinement]:
    """Return the refinements of a branch's steps.

    Args:
        owner: Steps of the branch.
        paths: Path of each step in the table.

    Raises:
        UndesignableError: The steps of a refinement make no branch.
    """
    return [
        _refinement(i, step, step.refined_by, paths)
        for i, step in enumerate(owner.order.steps)
        if step.refined_by is not None
    ]


def _refinement(index: int, step: StepSpec, spec: RefinementSpec, paths: Mapping[str, Path]) -> Refinement:
    if spec.points is not None:
        sequence = _sequence(step, spec)
        states = _states_in_order(spec.branch, sequence, (*paths[step.name], "refined_by"))
        return Refinement(spec.branch, spec.title, index, None, sequence, states, DONE)
    inner = group(spec.branch, spec.title, spec.steps, paths)
    order, below = inner.order, tuple(refinements_of(inner, paths))
    states = tuple(order.state(each) for each in order.combinations)
    return Refinement(spec.branch, spec.title, index, inner, None, states, order.state(order.all), below)


def _sequence(step: StepSpec, spec: RefinementSpec) -> SequenceSpec:
    roles: dict[str, Any] = {"roles": step.roles} if step.roles else {}
    plain = ActionSpec(operation=step.operation)
    keys = ("payload", "checks", "steps", "timeout_s")
    given = {key: getattr(step, key) for key in keys if getattr(step, key) != getattr(plain, key)}
    hazard = hazard_of(step)
    given |= hazard.keys | ({"requires": {ROBOT: [CONNECTED]}, "refusal": UNCONNECTED} if hazard.moves else {})
    return SequenceSpec(
        count=spec.points if isinstance(spec.points, int) else None,
        items=spec.points if isinstance(spec.points, list) else [],
        item=spec.item,
        perform=given | roles,
        repeat=roles,
        skip=roles,
        abandon=roles,
    )


def _states_in_order(name: str, sequence: SequenceSpec, path: Path) -> tuple[str, ...]:
    alone = Blueprint(id="points", version="1", branches={name: BranchSpec(sequence=sequence)})
    try:
        return tuple(expand(alone).branches[name].states)
    except SequenceError as error:
        key = "item" if error.path[-1] == "item" else "points"
        index = error.path[-1:] if error.path[-1].isdigit() else ()
        finding = Finding(code="bad_sequence", text=error.text, path=(*path, key, *index))
        raise UndesignableError(finding) from None


def parent_of(refinement: Refinement, owner: StepGroup) -> ParentSpec:
    """Return the parent of a refinement.

    Complete fits where the step is achieved, begun where it is possible, the start wherever it is not achieved.

    Args:
        refinement: The refinement.
        owner: Steps of the branch above.
    """
    order, step = owner.order, refinement.step
    achieved = [each for each in order.combinations if each >> step & 1]
    opened = [each for each in order.combinations if not each >> step & 1]
    possible = [each for each in order.possible_at(step) if not each >> step & 1]
    fits = {refinement.start: opened, refinement.complete: achieved} | ({"*": possible} if refinement.partial else {})
    return ParentSpec(
        branch=owner.name,
        start=order.state(order.first_possible(step)),
        compatible={state: [order.state(each) for each in fitting] for state, fitting in fits.items()},
    )


def emits_of(refinement: Refinement, step: StepSpec) -> dict[str, str]:
    """Return the signals of a refinement (Rule 2): complete achieves the step above, any other state takes it back.

    Args:
        refinement: The refinement.
        step: The step that it refines.
    """
    incomplete = "*" if refinement.partial else refinement.start
    return {incomplete: f"un{step.operation}", refinement.complete: step.operation}


def resting_on(step: int, refinements: Iterable[Refinement], owner: Order, *, signalled: bool = False) -> Requirement:
    """Return the requirement that nothing would be left behind when the step is done again or taken back.

    An operation can set the branches directly below its own to their start. It cannot reach further down while
    the branch between stays at its start, nor set anything where the step is done again further below and only
    signalled: there it is refused until the refinement that has begun is itself restarted.

    Args:
        step: Index of the step.
        refinements: Refinements of the steps beside it.
        owner: Steps beside it.
        signalled: The step is refined and done further below.
    """
    calm: Requirement = {}
    for each in refinements:
        needed = signalled and owner.needs[each.step] >> step & 1
        if needed or (each.below and owner.dependents[step] >> each.step & 1):
            calm |= each.calm()
    return calm
