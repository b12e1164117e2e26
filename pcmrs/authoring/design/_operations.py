"""Makes the operations of a designed branch: where each is valid, and which steps it achieves or re-opens."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import msgspec

from pcmrs.authoring.design._commands import REINIT, StepOperation
from pcmrs.authoring.design._hazards import GuardedOrder, ways_of
from pcmrs.authoring.design._order import Order
from pcmrs.authoring.design._refinement import Refinement, resting_on
from pcmrs.authoring.design._safety import CONNECTED, ROBOT, UNCONNECTED
from pcmrs.fsm.blueprint import OperationSpec, OutcomeSpec, Requirement, TransitionTarget

REFUSAL = "refinement_begun"
"""Code of the rejection while a refinement that rests on a step has begun and is not complete."""

Moves = Mapping[int, int]
"""Combination to its target combination."""


class Operations:
    """Builder of the operations of one branch.

    Args:
        order: Order of its steps.
        refinements: Refinements of its steps.
        above: Requirement on the branches above when an achieved step is done again or taken back: nothing in them has
            begun without being complete.
        refines: There is a branch above, which is then also signalled when steps are done again.
    """

    def __init__(self, order: Order, refinements: Sequence[Refinement], above: Requirement, *, refines: bool) -> None:
        self.order = order
        self.refinements = refinements
        self.above = above
        self.refines = refines

    def made(self, commands: Iterable[StepOperation]) -> dict[str, OperationSpec]:
        """Return all operations, the re-initiation last."""
        by_name: dict[str, list[StepOperation]] = {}
        for command in commands:
            by_name.setdefault(command.name, []).append(command)
        return {name: self._operation(shared) for name, shared in by_name.items()} | {REINIT: self._reinit()}

    def _operation(self, shared: list[StepOperation]) -> OperationSpec:
        command = shared[0]
        if command.kind == "reopen":
            return self._reopening(shared)
        if command.kind == "partial":
            return self._partial(command)
        if command.kind == "achieve":
            moves = {each: self.order.achieve(command.step, each) for each in self.order.possible_at(command.step)}
            keys = self._action(command, moves) | self._moved(moves) | self._guarded(shared)
            return OperationSpec(**keys, signals=self.refines, sets=self._resets(command))
        if command.kind in ("make_safe", "allow"):
            return self._reporting(command)
        change = self.order.achieve if command.kind == "signal" else self.order.reopen
        moves = {each: change(command.step, each) for each in self.order.possible_at(command.step)}
        return OperationSpec(**self._moved(moves), signals=self.refines, iio=True)

    def _partial(self, command: StepOperation) -> OperationSpec:
        opened = [each for each in self.order.possible_at(command.step) if not each >> command.step & 1]
        unchanged = self._moved({each: each for each in opened})
        moved = self._moved({each: self.order.achieve(command.step, each) for each in opened})
        outcomes = {"partial": OutcomeSpec(to=unchanged["to"]), "complete": OutcomeSpec(to=moved["to"])}
        keys = self._action(command, opened) | guarded({}, moves=command.hazard.moves)
        return OperationSpec(**keys, from_=unchanged["from_"], outcomes=outcomes, signals=self.refines)

    def _reopening(self, shared: list[StepOperation]) -> OperationSpec:
        steps = [command.step for command in shared]
        moves: dict[int, int] = {}
        for each in self.order.combinations:
            if any(self.order.reopenable(step, each) for step in steps):
                moves[each] = each
                for step in steps:
                    moves[each] = self.order.reopen(step, moves[each])
            elif shared[0].hazard.motion == "retreat" and self._stopped(each):
                moves[each] = each  # whatever was stopped may be moved away from the patient
        return OperationSpec(**self._action(shared[0], moves), **self._moved(moves), **self._guarded(shared))

    def _reporting(self, command: StepOperation) -> OperationSpec:
        """Return a report about the patient: nothing is there any more, or a step may be done again."""
        order, step = self.order, command.step
        if not isinstance(order, GuardedOrder):
            raise TypeError(f"{command.name} is an operation of steps that reach the patient")
        keys: dict[str, Any] = {"title": command.title, "roles": command.action.roles}
        if command.kind == "make_safe":
            moves = {each: order.made_safe(each) for each in order.combinations if order.unsafe(each)}
            return OperationSpec(**keys, **self._moved(moves))
        moves = {each: order.allow(step, each) for each in order.combinations if order.allowable(step, each)}
        again = [action.operation for action, hazard in ways_of(order.steps[step]) if hazard.irreversible]
        return OperationSpec(**keys, **self._moved(moves), allows_again=again, blocked_when_latched=True)

    def _action(self, command: StepOperation, sources: Iterable[int]) -> dict[str, Any]:
        """Return the keys for the action, and for its failure on the way to the patient."""
        action, hazard, order = command.action, command.hazard, self.order
        keys = {key: getattr(action, key) for key in ("payload", "checks", "steps", "roles", "timeout_s")} | hazard.keys
        if not (hazard.counts and hazard.performed and isinstance(order, GuardedOrder)):
            return keys
        if command.kind == "reopen":
            ends = {each: order.interrupted(each) for each in sources}
        else:
            ends = {each: order.failed(command.step, each) for each in sources}
        return keys | dict.fromkeys(("on_failure", "on_unknown"), self._moved(ends)["to"])

    def _stopped(self, combination: int) -> bool:
        return isinstance(self.order, GuardedOrder) and bool(combination & self.order.stopped)

    def _reinit(self) -> OperationSpec:
        sets = {each.name: each.start for each in self._resettable() if not self.order.needs[each.step]}
        nested = (each for each in self.refinements if each.below)
        calm = _merged([self.above, *(each.calm() for each in nested)])
        if not isinstance(self.order, GuardedOrder):
            return reinit_of(self.order.state(0), calm, sets)
        # Elsewhere a re-initiation would forget what is at the patient, or what cannot be undone.
        fresh = [self.order.state(each) for each in self.order.combinations if self.order.fresh(each)]
        return msgspec.structs.replace(reinit_of(self.order.state(0), calm, sets), from_=fresh)

    def _resets(self, command: StepOperation) -> dict[str, str]:
        """Return the states that restart each refinement which rests on the step, even if no state changes."""
        needs = self.order.needs
        return {each.name: each.start for each in self._resettable() if needs[each.step] >> command.step & 1}

    def _resettable(self) -> list[Refinement]:
        return [each for each in self.refinements if each.partial and not each.below]

    def _guarded(self, shared: Iterable[StepOperation]) -> dict[str, Any]:
        shared = list(shared)
        resting = [resting_on(command.step, self.refinements, self.order) for command in shared]
        return guarded(_merged([self.above, *resting]), moves=shared[0].hazard.moves)

    def _moved(self, moves: Moves) -> dict[str, Any]:
        """Return `from` and `to`, as short as possible."""
        state = self.order.state
        everywhere = len(moves) == len(self.order.combinations)
        to: TransitionTarget = {state(source): state(target) for source, target in moves.items()}
        ends = set(moves.values())
        return {
            "from_": ["*"] if everywhere else [state(source) for source in moves],
            "to": state(ends.pop()) if len(ends) == 1 else to,
        }


def reinit_of(start: str, requires: Requirement, sets: dict[str, str]) -> OperationSpec:
    """Return the re-initiation operation of a branch.

    Args:
        start: Starting state of the branch.
        requires: Its requirement.
        sets: Child branch to the state that it sets.
    """
    return OperationSpec(title="Begin again", from_=["*"], to=start, rio=True, sets=sets, **guarded(requires))


def guarded(requires: Requirement, *, moves: bool = False) -> dict[str, Any]:
    """Return the keys for a requirement and for the code of its rejection.

    Args:
        requires: Refinements in which nothing has begun without being complete.
        moves: It moves the robot, which must then be connected.
    """
    if moves:
        refusals = dict.fromkeys(requires, REFUSAL) | {ROBOT: UNCONNECTED}
        return {"requires": requires | {ROBOT: [CONNECTED]}, "refusal": refusals}
    return {"requires": requires, "refusal": REFUSAL} if requires else {}


def _merged(requirements: Iterable[Requirement]) -> Requirement:
    return {branch: states for each in requirements for branch, states in each.items()}
