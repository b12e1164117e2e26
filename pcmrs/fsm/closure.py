"""The closure of a command: everything it would change, worked out before anything is done.

A command's closure is its operation with each of its outcomes, the parents' operations it calls
(Rule 2), the children it re-initiates (Rule 3, or because they no longer fit), the states it sets and
the states it revokes. If any part of it is not allowed, the command is not allowed.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, Literal

from pcmrs.fsm.blueprint import UNMET, Blueprint, OperationSpec, OutcomeSpec, ParentSpec, Requirement, target_from

MAX_EFFECTS = 64
"""Limit of a cascade at run time; the loader has proved that none reaches it."""

EffectKind = Literal["operation", "signal", "reinit", "set", "revoke"]


@dataclass(frozen=True, slots=True)
class Effect:
    """One branch that a commit touches, and how: `source` and `target` may be equal."""

    kind: EffectKind
    branch: str
    operation: str
    source: str
    target: str


@dataclass(frozen=True)
class Change:
    """One way a command can end: the joint state after it, and the effects in order."""

    states: Mapping[str, str]
    effects: tuple[Effect, ...]

    @cached_property
    def moved(self) -> frozenset[str]:
        """Branches whose state or data it changes; a signal that finds its target reached changes nothing."""
        return frozenset(e.branch for e in self.effects if e.kind != "signal" or e.source != e.target)

    @cached_property
    def targets(self) -> dict[str, str]:
        """The state that each branch it touches is in after it."""
        return {effect.branch: self.states[effect.branch] for effect in self.effects}


@dataclass(frozen=True, slots=True)
class Denial:
    """Reason why a command is not allowed; a value, not an exception."""

    code: str
    text: str
    fields: dict[str, Any] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Closure:
    """Everything an allowed command may change.

    Attributes:
        outcomes: The outcomes that can be taken now.
        failure: Change that is committed if a step refuses, raises or is stopped.
        unknown: Change that is committed if its ending is unknown.
        writes: Branches to lock for writing.
        reads: Branches to lock for reading.
    """

    outcomes: Mapping[str, Change]
    failure: Change | None
    unknown: Change | None
    writes: frozenset[str]
    reads: frozenset[str]


class DeniedError(Exception):
    """Denial inside a cascade; never leaves `pcmrs.fsm`."""

    def __init__(self, denial: Denial) -> None:
        super().__init__(denial.text)
        self.denial = denial


Answer = OperationSpec | Denial
"""Answer of a state to an operation: how to perform it, or why not."""

Ask = Callable[[str, str, str], Answer]
"""Asks a state for an operation: (branch, state, operation) → its answer."""


Follow = Callable[[Blueprint, Mapping[str, str], str, str, OutcomeSpec, OperationSpec, Ask], Change]
"""Follows a cascade, see `follow_cascade`."""


def _as_declared(blueprint: Blueprint) -> Ask:
    """Return a function that answers as the blueprint declares."""

    def ask(branch: str, state: str, operation: str) -> Answer:
        spec = blueprint.branches[branch]
        if spec.valid_in(operation, state):
            return spec.operations[operation]
        return Denial("invalid_in_state", f"{branch} in {state} does not allow {operation}.")

    return ask


def follow_cascade(
    blueprint: Blueprint,
    states: Mapping[str, str],
    branch: str,
    operation: str,
    ending: OutcomeSpec,
    spec: OperationSpec,
    ask: Ask,
) -> Change:
    """Return everything that changes when an operation ends in one way.

    Args:
        blueprint: The workflow.
        states: The present joint state: branch to state.
        branch: Branch of the operation.
        operation: Name of the operation.
        ending: How it ends.
        spec: Declaration of the operation.
        ask: See `close`.

    Raises:
        DeniedError: Some part of it is not allowed.
    """
    cascade = _Cascade(blueprint, dict(states), ask, {(branch, other): to for other, to in ending.diverted.items()})
    cascade.perform("operation", branch, operation, target_from(ending.to, states[branch]), spec)
    return Change(cascade.states, tuple(cascade.effects))


def close(
    blueprint: Blueprint,
    states: Mapping[str, str],
    branch: str,
    operation: str,
    ask: Ask | None = None,
    follow: Follow = follow_cascade,
) -> Closure | Denial:
    """Work out the closure of a requested operation.

    Args:
        blueprint: The workflow.
        states: The present joint state: branch to state.
        branch: Branch of the operation.
        operation: Any of its operations.
        ask: Function that says what is valid and how it is performed: a daemon's state objects; by default the
            blueprint.
        follow: Function that follows a cascade; it may remember what follows.

    Returns:
        The closure, or why the branch's state or some other part of it does not allow it.
    """
    ask = ask or _as_declared(blueprint)
    spec = ask(branch, states[branch], operation)
    if isinstance(spec, Denial):
        return spec

    def change(ending: OutcomeSpec) -> Change:
        return follow(blueprint, states, branch, operation, ending, spec, ask)

    # Requirements come first: of all denials, theirs alone have a code of the workflow.
    denial = unmet(states, spec.requires, spec.refusal, f"{branch}.{operation}")
    if denial is not None:
        return denial
    outcomes: dict[str, Change] = {}
    try:
        for name, ending in spec.endings.items():
            # An outcome whose requirement does not hold is left out; it is no reason to deny the command.
            if unmet(states, ending.requires, "", "") is None:
                outcomes[name] = change(ending)
        unconfirmed = {name: change(ending) for name, ending in spec.unconfirmed.items()}
    except DeniedError as raised:
        return raised.denial
    if not outcomes:
        return Denial("no_outcome", f"{branch}.{operation} cannot end in any declared way in this situation.")
    failure, unknown = unconfirmed.get("failed"), unconfirmed.get("unknown")
    writes = frozenset({branch}).union(*(each.moved for each in (*outcomes.values(), *unconfirmed.values())))
    return Closure(outcomes, failure, unknown, writes, blueprint.examined[branch, operation] - writes)


def unmet(
    states: Mapping[str, str], requires: Requirement, refusal: str | Mapping[str, str], what: str
) -> Denial | None:
    """Return the first requirement on other branches that does not hold, as a denial.

    Args:
        states: Joint state: branch to state.
        requires: Requirement to check.
        refusal: Code of the denial, or one code for each branch.
        what: Name of the operation in the text of the denial.
    """
    for branch, wanted in requires.items():
        if states[branch] not in wanted:
            code = refusal if isinstance(refusal, str) else refusal.get(branch, UNMET)
            text = f"{what} needs {branch} in {' or '.join(wanted)}; it is in {states[branch]}."
            return Denial(code, text, {"branch": branch, "state": states[branch], "needed": wanted})
    return None


class _Cascade:
    """Application of one outcome to a copy of the joint state, and of what it triggers.

    Args:
        blueprint: The workflow.
        states: Copy of the joint state, which is changed.
        ask: See `close`.
        diverted: Revoking and revoked branch to the state that the revocation leads to, in place of that of the rule.
    """

    def __init__(
        self, blueprint: Blueprint, states: dict[str, str], ask: Ask, diverted: Mapping[tuple[str, str], str]
    ) -> None:
        self.blueprint = blueprint
        self.states = states
        self.ask = ask
        self.diverted = diverted
        self.effects: list[Effect] = []

    def perform(
        self, kind: EffectKind, branch: str, operation: str, target: str, spec: OperationSpec | None = None
    ) -> None:
        """Move `branch` to `target`; then set, signal, re-initiate and revoke what follows from it."""
        source = self._move(kind, branch, operation, target)
        if spec is not None and kind == "operation":
            for child, state in spec.sets.items():
                before = self._move("set", child, operation, state)
                self._fit_children(child, before, direct=False)
        # A re-initiation follows a change of the parent, which must not be signalled back to it.
        if kind != "reinit" and (source != target or (spec is not None and spec.signals)):
            self._signal_parent(branch, target)
        direct = kind != "signal"
        self._fit_children(branch, source, direct=direct)
        # A command that keeps the state may still have changed its data, which others depend on; a signal has no data.
        if source != target or direct:
            self._revoke(branch)

    def _move(self, kind: EffectKind, branch: str, operation: str, target: str) -> str:
        if len(self.effects) >= MAX_EFFECTS:
            raise DeniedError(Denial("cascade_too_long", f"{operation} triggers over {MAX_EFFECTS} effects."))
        source = self.states[branch]
        self.states[branch] = target
        self.effects.append(Effect(kind, branch, operation, source, target))
        return source

    def _signal_parent(self, branch: str, target: str) -> None:
        """Rule 2: a change at level N+1 calls an operation at level N (IIO)."""
        spec = self.blueprint.branches[branch]
        if spec.parent is None:
            return
        parent, operation = spec.parent.branch, spec.emits[target]
        state = self.states[parent]
        called = self.ask(parent, state, operation)
        if isinstance(called, Denial):
            text = f"{branch} going to {target} would call {parent}.{operation}, which {parent} {state} does not allow."
            fields = {"branch": parent, "state": state, "operation": operation}
            raise DeniedError(Denial("parent_refuses", text, fields))
        for ending in called.endings.values():
            self.perform("signal", parent, operation, target_from(ending.to, state), called)

    def _fit_children(self, branch: str, source: str, *, direct: bool) -> None:
        """Rule 3 for a direct change into a child's starting state, and children that no longer fit."""
        for child, parent in self.blueprint.children[branch].items():
            state = self.states[branch]  # a revocation on the way may have moved it
            rule_3 = direct and source != state and state == parent.start
            fits = state in parent.compatible[self.states[child]]
            if (rule_3 and not self._set_by_this_command(child)) or not fits:
                self._reinitiate(child, parent, state)

    def _reinitiate(self, child: str, parent: ParentSpec, parent_state: str) -> None:
        spec = self.blueprint.branches[child]
        if parent_state not in parent.compatible[spec.start]:
            text = f"{child} fits {parent.branch} {parent_state} neither as it is nor re-initiated."
            raise DeniedError(Denial("incompatible_child", text, {"branch": child, "parent_state": parent_state}))
        self.perform("reinit", child, spec.rio or "", spec.start)

    def _set_by_this_command(self, child: str) -> bool:
        return any(effect.kind == "set" and effect.branch == child for effect in self.effects)

    def _revoke(self, changed: str) -> None:
        for branch, rule in self.blueprint.revocations_by.get(changed, ()):
            if self.states[branch] in rule.from_:
                self.perform("revoke", branch, "", self.diverted.get((changed, branch), rule.to))
