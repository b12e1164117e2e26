"""Links between branches: Rule 2, Rule 3 and revocations."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from pcmrs.authoring.chart._arrows import Kind, StateRef
from pcmrs.fsm.blueprint import Blueprint


@dataclass(frozen=True, slots=True)
class BranchLink:
    """A line from branch to branch, with several beginnings and ends.

    Attributes:
        kind: `signal` (Rule 2), `call` (Rule 3) or `revocation`.
        tails: Places at which it begins.
        heads: Places at which it ends.
        label: The operation that is called; empty for a revocation, which calls none.
    """

    kind: Kind
    tails: tuple[StateRef, ...]
    heads: tuple[StateRef, ...]
    label: str

    @property
    def places(self) -> tuple[StateRef, ...]:
        """All places that it joins."""
        return (*self.tails, *self.heads)


def links(blueprint: Blueprint) -> list[BranchLink]:
    """Return all links of a workflow: child states to the parent's operations, parent states to RIOs, revocations."""
    return [link for name in blueprint.branches for link in (*_rules(blueprint, name), *_revocations(blueprint, name))]


def _rules(blueprint: Blueprint, name: str) -> Iterator[BranchLink]:
    branch = blueprint.branches[name]
    if branch.parent is None:
        return
    above = branch.parent.branch
    for called in dict.fromkeys(branch.emits.values()):
        tails = tuple(StateRef(name, state) for state in branch.states if branch.emits.get(state) == called)
        reached = blueprint.branches[above].operations[called].targets()
        heads = tuple(StateRef(above, state) for state in blueprint.branches[above].states if state in reached)
        yield BranchLink("signal", tails, heads, called)
    yield BranchLink("call", (StateRef(above, branch.parent.start),), (StateRef(name, branch.start),), branch.rio or "")


def _revocations(blueprint: Blueprint, name: str) -> Iterator[BranchLink]:
    for by in dict.fromkeys(tuple(rule.by) for rule in blueprint.branches[name].revocations):
        tails = tuple(StateRef(other, "") for other in by if other != name)
        if tails:
            yield BranchLink("revocation", tails, (StateRef(name, ""),), "")
