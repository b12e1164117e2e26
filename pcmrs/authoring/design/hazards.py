"""What the actions of a table do to the patient, and the states of a branch in which that is kept track of."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

from pcmrs.authoring.design.order import MAX_COMBINATIONS, Order, TooManyCombinationsError
from pcmrs.authoring.design.table import ActionSpec, StepSpec
from pcmrs.fsm.blueprint import Motion


@dataclass(frozen=True, slots=True)
class Hazard:
    """What an action does to the patient.

    Attributes:
        motion: How it moves the robot.
        affects: It acts on the patient without moving the robot.
        irreversible: It cannot be undone.
        confirm: It is confirmed each time.
        performed: The daemon performs it, by steps that may fail; otherwise people do, and report it.
    """

    motion: Motion
    affects: bool
    irreversible: bool
    confirm: bool
    performed: bool

    @property
    def moves(self) -> bool:
        """Whether it moves the robot."""
        return self.motion != "none"

    @property
    def exposes(self) -> bool:
        """Whether something is at or in the patient afterwards, so that it takes a way back."""
        return self.moves or self.affects

    @property
    def counts(self) -> bool:
        """Whether the branch keeps track of it."""
        return self.exposes or self.irreversible

    @property
    def keys(self) -> dict[str, Any]:
        """The keys of its operation. What people do themselves the daemon only bars: it moves nothing then."""
        keys: dict[str, Any] = {"motion": self.motion} if self.moves and self.performed else {}
        if self.affects or (self.moves and not self.performed):
            keys["affects_patient"] = True
        return keys | {key: True for key in ("irreversible", "confirm") if getattr(self, key)}


NONE = Hazard("none", affects=False, irreversible=False, confirm=False, performed=False)
"""Of what people only report, and of signals."""


def hazard_of(action: ActionSpec, step: ActionSpec | None = None) -> Hazard:
    """What an action does to the patient; what it does not say is as `step` says, where that is given."""

    def said(key: str) -> Any:
        own = getattr(action, key)
        return getattr(step, key) if own is None and step is not None else own

    moves = said("moves")
    return Hazard(
        motion=("approach" if moves else "none") if isinstance(moves, bool | None) else moves,
        affects=bool(said("affects_patient")),
        irreversible=bool(said("irreversible")),
        confirm=bool(said("confirm")),
        performed=bool(action.steps),
    )


def ways_of(step: StepSpec) -> list[tuple[ActionSpec, Hazard]]:
    """The actions that achieve a step, and what each does to the patient; none of one that is refined."""
    if step.refined_by is not None:
        return []
    return [(step, hazard_of(step)), *((other, hazard_of(other, step)) for other in step.alternatives)]


def hazards_in(steps: Iterable[StepSpec]) -> Iterator[Hazard]:
    """What all actions of some steps do to the patient, those of the points of a step too."""
    for step in steps:
        yield from _hazards_of(step)
        if step.refined_by is not None:
            yield hazard_of(step)


def is_hazardous(steps: Sequence[StepSpec]) -> bool:
    """Whether any of the steps of a branch reaches the patient, or cannot be undone."""
    return any(hazard.counts for step in steps for hazard in _hazards_of(step))


def _hazards_of(step: StepSpec) -> Iterator[Hazard]:
    yield from (hazard for _, hazard in ways_of(step))
    yield from map(hazard_of, step.reopeners())


class GuardedOrder(Order):
    """Steps of which some move, affect the patient or cannot be undone.

    Beside the steps that are achieved, a combination says which irreversible ones have been done, whether they still
    count as achieved or not, and whether something was stopped on its way, so that nobody knows what is at the
    patient. While something is at the patient, nothing it rests on is done again or taken back.

    Args:
        name: Of the branch.
        steps: As for `Order`.

    Attributes:
        exposed: The steps after which something is at or in the patient, as bits.
        moving: Those of them that move the robot, as bits.
        once: The irreversible steps.
        stopped: The bit that says that something was stopped on its way; 0 where nothing can be.
    """

    def __init__(self, name: str, steps: Sequence[StepSpec]) -> None:
        super().__init__(steps)
        hazards = [[hazard for _, hazard in ways_of(step)] for step in steps]
        self.exposed = _bits(any(each.exposes for each in ways) for ways in hazards)
        self.moving = _bits(any(each.moves for each in ways) for ways in hazards)
        self.once = [i for i, ways in enumerate(hazards) if any(each.irreversible for each in ways)]
        self._guarded = _bits(any(each.counts for each in ways) for ways in hazards)
        self._failing = [i for i, ways in enumerate(hazards) if any(map(_may_fail, ways))]
        self._failing_back = [
            i for i, step in enumerate(steps) if any(map(_may_fail, map(hazard_of, step.reopeners())))
        ]
        self.flags += [f"{steps[i].operation}_spent" for i in self.once]
        self.stopped = 0
        if self._failing or self._failing_back or self.moving:
            self.stopped = 1 << len(self.flags)
            self.flags.append(f"{name}_stopped")
        self.combinations = self._reached()

    @property
    def all(self) -> int:
        """All steps achieved, nothing stopped."""
        return self._every | sum(self.spent(step) for step in self.once)

    @property
    def _resting(self) -> int:
        """What is at the patient, and all that depends on that, as bits."""
        resting = self.exposed
        for step in _members(self.exposed):
            resting |= self.dependents[step]
        return resting

    def spent(self, step: int) -> int:
        """The bit that says that an irreversible step has been done; 0 for others."""
        return 1 << len(self) + self.once.index(step) if step in self.once else 0

    def meaning(self, combination: int) -> str:
        """What is achieved, what cannot be done again, and whether something was stopped, in words."""
        texts = [super().meaning(combination)]
        done = [i for i in self.once if combination & self.spent(i) and not combination >> i & 1]
        texts += [f"{self.steps[i].operation} cannot be done again" for i in done]
        return "; ".join(texts + ["stopped, and not known to be safe"] * bool(combination & self.stopped))

    def possible(self, step: int, combination: int) -> bool:
        """Whether all it depends on is achieved, nothing at the patient rests on it, and it may be done again."""
        barred = self.spent(step) | (self.stopped if self._guarded >> step & 1 else 0)
        barred |= self.dependents[step] & self.exposed
        return super().possible(step, combination) and not combination & barred

    def reopenable(self, step: int, combination: int) -> bool:
        """Whether the step is achieved, and nothing at the patient rests on it."""
        return super().reopenable(step, combination) and not combination & self.dependents[step] & self.exposed

    def achieve(self, step: int, combination: int) -> int:
        """The combination after doing the step."""
        return super().achieve(step, combination) | self.spent(step)

    def failed(self, step: int, combination: int) -> int:
        """The combination after the step has failed: what has begun counts as done where it cannot be undone."""
        return self.interrupted(self.reopen(step, combination)) | self.spent(step)

    def interrupted(self, combination: int) -> int:
        """The combination when nobody knows any more what is at the patient."""
        return combination & ~self._resting | self.stopped

    def made_safe(self, combination: int) -> int:
        """The combination once nothing is at the patient."""
        return combination & ~self._resting & ~self.stopped

    def unsafe(self, combination: int) -> bool:
        """Whether something is at the patient, or may be."""
        return bool(combination & (self.exposed | self.stopped))

    def allowable(self, step: int, combination: int) -> bool:
        """Whether an irreversible step was done, and can be allowed again."""
        barred = self.stopped | (1 << step | self.dependents[step]) & self.exposed
        return bool(combination & self.spent(step)) and not combination & barred

    def allow(self, step: int, combination: int) -> int:
        """The combination after an irreversible step is allowed again."""
        return self.reopen(step, combination) & ~self.spent(step)

    def fresh(self, combination: int) -> bool:
        """Whether the branch can be begun again as a whole: nothing is at the patient, nothing has been spent."""
        return not self.unsafe(combination) and not any(combination & self.spent(step) for step in self.once)

    def first_possible(self, step: int) -> int:
        """The smallest combination in which the step can be done."""
        closed = super().first_possible(step)
        return closed | sum(self.spent(i) for i in self.once if closed >> i & 1)

    def _reached(self) -> list[int]:
        """Every combination that commands lead to, the start first."""
        found = [0]
        known = set(found)
        for each in found:
            new = [after for after in dict.fromkeys(self._after(each)) if after not in known]
            found += new
            known.update(new)
            if len(found) > MAX_COMBINATIONS:
                raise TooManyCombinationsError
        return found

    def _after(self, combination: int) -> Iterator[int]:
        """Where one command leads."""
        for i, step in enumerate(self.steps):
            if self.possible(i, combination):
                yield self.achieve(i, combination)
                if i in self._failing:
                    yield self.failed(i, combination)
            if (step.reopened_by or step.refined_by is not None) and self.reopenable(i, combination):
                yield self.reopen(i, combination)
                if i in self._failing_back:
                    yield self.interrupted(combination)
        if self.unsafe(combination):
            yield self.made_safe(combination)
        if combination & self.moving:
            yield self.interrupted(combination)
        yield from (self.allow(i, combination) for i in self.once if self.allowable(i, combination))


def _may_fail(hazard: Hazard) -> bool:
    """Whether it may fail on its way to or from the patient."""
    return hazard.counts and hazard.performed


def _bits(marks: Iterable[bool]) -> int:
    return sum(1 << i for i, marked in enumerate(marks) if marked)


def _members(bits: int) -> Iterator[int]:
    return (i for i in range(bits.bit_length()) if bits >> i & 1)
