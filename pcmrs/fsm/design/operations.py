"""The operations of a designed branch: where each is valid, and what it achieves or opens again."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from pcmrs.fsm.blueprint import OperationSpec, OutcomeSpec, Requirement, Target
from pcmrs.fsm.design.commands import REINIT, Command
from pcmrs.fsm.design.order import Order
from pcmrs.fsm.design.refinement import Refinement, resting_on

REFUSAL = "refinement_begun"
"""Code of the rejection while something that rests on a step has begun and is not complete."""

Moves = Mapping[int, int]
"""Combination to the one gone to."""


class Operations:
    """Makes the operations of one branch.

    Args:
        order: Its steps.
        refinements: Of its steps.
        above: What must be calm above where a step that has been achieved is done again or taken back.
        refines: Whether there is a branch above, which then hears of steps that are done again, too.
    """

    def __init__(self, order: Order, refinements: Sequence[Refinement], above: Requirement, *, refines: bool) -> None:
        self.order = order
        self.refinements = refinements
        self.above = above
        self.refines = refines

    def made(self, commands: Iterable[Command]) -> dict[str, OperationSpec]:
        """All operations, the re-initiation last."""
        by_name: dict[str, list[Command]] = {}
        for command in commands:
            by_name.setdefault(command.name, []).append(command)
        return {name: self._operation(shared) for name, shared in by_name.items()} | {REINIT: self._reinit()}

    def _operation(self, shared: list[Command]) -> OperationSpec:
        command = shared[0]
        if command.kind == "reopen":
            return self._reopening(shared)
        if command.kind == "partial":
            return self._partial(command)
        if command.kind == "achieve":
            moves = {each: self.order.achieve(command.step, each) for each in self.order.possible_at(command.step)}
            keys = _action(command) | self._moved(moves) | self._guarded(shared)
            return OperationSpec(**keys, signals=self.refines, sets=self._begun(command))
        change = self.order.achieve if command.kind == "signal" else self.order.reopen
        moves = {each: change(command.step, each) for each in self.order.possible_at(command.step)}
        return OperationSpec(**self._moved(moves), signals=self.refines, iio=True)

    def _partial(self, command: Command) -> OperationSpec:
        opened = [each for each in self.order.possible_at(command.step) if not each >> command.step & 1]
        kept = self._moved({each: each for each in opened})
        moved = self._moved({each: self.order.achieve(command.step, each) for each in opened})
        outcomes = {"partial": OutcomeSpec(to=kept["to"]), "complete": OutcomeSpec(to=moved["to"])}
        return OperationSpec(**_action(command), from_=kept["from_"], outcomes=outcomes, signals=self.refines)

    def _reopening(self, shared: list[Command]) -> OperationSpec:
        steps = [command.step for command in shared]
        moves: dict[int, int] = {}
        for each in self.order.combinations:
            if any(each >> step & 1 for step in steps):
                moves[each] = each
                for step in steps:
                    moves[each] = self.order.reopen(step, moves[each])
        return OperationSpec(**_action(shared[0]), **self._moved(moves), **self._guarded(shared))

    def _reinit(self) -> OperationSpec:
        sets = {each.name: each.start for each in self._resettable() if not self.order.needs[each.step]}
        nested = (each for each in self.refinements if each.below)
        return reinit_of(self.order.state(0), _merged([self.above, *(each.calm() for each in nested)]), sets)

    def _begun(self, command: Command) -> dict[str, str]:
        """Refinements that rest on the step: what has begun in them is begun again, even where no state changes."""
        needs = self.order.needs
        return {each.name: each.start for each in self._resettable() if needs[each.step] >> command.step & 1}

    def _resettable(self) -> list[Refinement]:
        return [each for each in self.refinements if each.partial and not each.below]

    def _guarded(self, shared: Iterable[Command]) -> dict[str, Any]:
        resting = [resting_on(command.step, self.refinements, self.order) for command in shared]
        return guarded(_merged([self.above, *resting]))

    def _moved(self, moves: Moves) -> dict[str, Any]:
        """`from` and `to`, as short as they can be said."""
        state = self.order.state
        everywhere = len(moves) == len(self.order.combinations)
        to: Target = {state(source): state(target) for source, target in moves.items()}
        ends = set(moves.values())
        return {
            "from_": ["*"] if everywhere else [state(source) for source in moves],
            "to": state(ends.pop()) if len(ends) == 1 else to,
        }


def _action(command: Command) -> dict[str, Any]:
    action = command.action
    return {key: getattr(action, key) for key in ("payload", "checks", "steps", "roles", "timeout_s")}


def reinit_of(start: str, requires: Requirement, sets: dict[str, str]) -> OperationSpec:
    """The re-initiation operation of a branch."""
    return OperationSpec(title="Begin again", from_=["*"], to=start, rio=True, sets=sets, **guarded(requires))


def guarded(requires: Requirement) -> dict[str, Any]:
    """What is required, and how its absence is called."""
    return {"requires": requires, "refusal": REFUSAL} if requires else {}


def _merged(requirements: Iterable[Requirement]) -> Requirement:
    return {branch: states for each in requirements for branch, states in each.items()}
