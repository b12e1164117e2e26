"""Cascades of a workflow, each followed once for the states that it depends on."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

from pcmrs.fsm.blueprint import Blueprint, OperationSpec, OutcomeSpec, target_from
from pcmrs.fsm.closure import Ask, Change, Denial, DeniedError, follow_cascade
from pcmrs.fsm.verify._observed import DependencyObserver


@dataclass(frozen=True, slots=True)
class FollowedCascade:
    """A cascade that was followed.

    Attributes:
        end: Everything that changes, or why it is not allowed.
        seen: States that it depends on, in the order of reading.
        also_seen: States that it depends on if the branches of the file are in another order.
        ordered: It ends otherwise if they are.
    """

    end: Change | Denial
    seen: dict[str, str]
    also_seen: dict[str, str]
    ordered: bool


@dataclass(frozen=True, slots=True)
class _Question:
    """A branch that a cascade looks at next, and what follows from each of its states that has occurred."""

    branch: str
    below: dict[object, _Question | FollowedCascade] = field(default_factory=dict)


class Cascades:
    """What follows when a branch is taken to a state.

    Most operations of a branch lead to few states, and what follows does not depend on which of them leads there.

    Args:
        observer: Notes what a cascade depends on.
        reordered: Copies of the workflow with their branches in other orders, if order is to be checked.

    Attributes:
        followed: Cascades that were followed; to be emptied by the user.
    """

    def __init__(self, observer: DependencyObserver, reordered: Sequence[Blueprint]) -> None:
        self.followed: list[FollowedCascade] = []
        self._observer = observer
        self._reordered = reordered
        self._known: dict[object, _Question | FollowedCascade] = {}

    def follow(
        self,
        blueprint: Blueprint,
        states: Mapping[str, str],
        branch: str,
        operation: str,
        ending: OutcomeSpec,
        spec: OperationSpec,
        ask: Ask,
    ) -> Change:
        """Follow a cascade in the observed joint state, see `pcmrs.fsm.closure.follow_cascade`.

        The first effect of a change may have the name of another operation that has led to it before.
        """
        now = self._observer.states
        sets, diverted = tuple(spec.sets.items()), tuple(ending.diverted.items())
        start = (branch, now[branch], target_from(ending.to, now[branch]), spec.signals, sets, diverted)
        known = self._known.get(start)
        while isinstance(known, _Question):
            known = known.below.get(now[known.branch])
        if known is None:
            known = self._follow(
                blueprint, branch, lambda order: follow_cascade(order, states, branch, operation, ending, spec, ask)
            )
            self._remember(start, known)
        self.followed.append(known)
        self._observer.seen.update(known.seen)  # states that were seen before keep their places
        if isinstance(known.end, Denial):
            raise DeniedError(known.end)
        return known.end

    def _follow(self, blueprint: Blueprint, branch: str, follow: Callable[[Blueprint], Change]) -> FollowedCascade:
        """Follow a cascade of a branch in all orders of the branches, and note what else it depends on."""
        before, self._observer.seen = self._observer.seen, {}
        end = _end_of(follow, blueprint)
        seen, self._observer.seen = self._observer.seen, {}
        others = [_end_of(follow, order) for order in self._reordered] if _has_sequel(end) else []
        ordered = any(_result(each) != _result(end) for each in others)
        also_seen, self._observer.seen = self._observer.seen, before
        # The state of the branch itself is part of the start. A target by source looks at it, another one does not.
        seen.pop(branch, None)
        also_seen.pop(branch, None)
        return FollowedCascade(end, seen, also_seen, ordered)

    def _remember(self, start: object, found: FollowedCascade) -> None:
        below, answer = self._known, start
        for name, state in (found.seen | found.also_seen).items():
            question = below.setdefault(answer, _Question(name))
            if not isinstance(question, _Question) or question.branch != name:
                raise TypeError("a cascade is not a function of the joint state")
            below, answer = question.below, state
        below[answer] = found


def _end_of(follow: Callable[[Blueprint], Change], order: Blueprint) -> Change | Denial:
    try:
        return follow(order)
    except DeniedError as error:
        return error.denial


def _has_sequel(end: Change | Denial) -> bool:
    """Return true unless nothing was re-initiated or revoked: only that is done in the order of the branches."""
    return isinstance(end, Denial) or any(effect.kind in ("reinit", "revoke") for effect in end.effects)


def _result(end: Change | Denial) -> object:
    return end.code if isinstance(end, Denial) else end.targets
