"""Effects of the actions of a table on the patient, and the states of a branch that keep track of them."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

from pcmrs.authoring.design._order import MAX_COMBINATIONS, Order, TooManyCombinationsError
from pcmrs.authoring.design.tables import ActionSpec, StepSpec
from pcmrs.fsm.blueprint import Motion


@dataclass(frozen=True, slots=True)
class Hazard:
    """Effect of an action on the patient.

    Attributes:
        motion: Direction of its motion.
        affects: It acts on the patient without moving the robot.
        irreversible: It cannot be undone.
        confirm: It is confirmed each time.
        performed: The daemon performs it, by steps that may fail; otherwise people perform and report it.
    """

    motion: Motion
    affects: bool
    irreversible: bool
    confirm: bool
    performed: bool

    @property
    def moves(self) -> bool:
        """It moves the robot."""
        return self.motion != "none"

    @property
    def exposes(self) -> bool:
        """Something is at or in the patient afterwards, so that a way back is needed."""
        return self.moves or self.affects

    @property
    def counts(self) -> bool:
        """The branch keeps track of it."""
        return self.exposes or self.irreversible

    @property
    def keys(self) -> dict[str, Any]:
        """Keys of its operation. If people perform it, the daemon only bars it: it moves nothing then."""
        keys: dict[str, Any] = {"motion": self.motion} if self.moves and self.performed else {}
        if self.affects or (self.moves and not self.performed):
            keys["affects_patient"] = True
        return keys | {key: True for key in ("irreversible", "confirm") if getattr(self, key)}


NONE = Hazard("none", affects=False, irreversible=False, confirm=False, performed=False)
"""Effect of mere reports, and of signals."""


def hazard_of(action: ActionSpec, step: ActionSpec | None = None) -> Hazard:
    """Return the effect of an action on the patient.

    Args:
        action: The action.
        step: The step that it belongs to, whose declarations it inherits.
    """

    def declared(key: str) -> Any:
        own = getattr(action, key)
        return getattr(step, key) if own is None and step is not None else own

    moves = declared("moves")
    return Hazard(
        motion=("approach" if moves else "none") if isinstance(moves, bool | None) else moves,
        affects=bool(declared("affects_patient")),
        irreversible=bool(declared("irreversible")),
        confirm=bool(declared("confirm")),
        performed=bool(action.steps),
    )


def ways_of(step: StepSpec) -> list[tuple[ActionSpec, Hazard]]:
    """Return the actions that achieve a step, each with its effect on the patient; none for a refined step."""
    if step.refined_by is not None:
        return []
    return [(step, hazard_of(step)), *((other, hazard_of(other, step)) for other in step.alternatives)]


def hazards_in(steps: Iterable[StepSpec]) -> Iterator[Hazard]:
    """Return the effects on the patient of all actions of some steps, also of those of their points."""
    for step in steps:
        yield from _hazards_of(step)
        if step.refined_by is not None:
            yield hazard_of(step)


def is_hazardous(steps: Sequence[StepSpec]) -> bool:
    """Return true if any of the steps of a branch reaches the patient, or cannot be undone."""
    return any(hazard.counts for step in steps for hazard in _hazards_of(step))


def _hazards_of(step: StepSpec) -> Iterator[Hazard]:
    yield from (hazard for _, hazard in ways_of(step))
    yield from map(hazard_of, step.reopeners())


class GuardedOrder(Order):
    """Steps of which some move, affect the patient or cannot be undone.

    Besides the achieved steps, a combination says which irreversible steps have been done, whether they still
    count as achieved or not, and whether a step was stopped halfway, so that it is unknown what is at the
    patient. While something is at the patient, no step that it rests on is repeated or taken back.

    Args:
        name: Name of the branch.
        steps: Steps, as for `Order`.

    Attributes:
        exposed: The steps after which something is at or in the patient, as bits.
        moving: Those of them that move the robot, as bits.
        once: The irreversible steps.
        stopped: The bit that says that a step was stopped halfway; 0 if none can be.
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
        # Steps that people perform cannot fail, but a lost robot stops any motion halfway.
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
        """Steps that are at the patient, and all that depend on them, as bits."""
        resting = self.exposed
        for step in _members(self.exposed):
            resting |= self.dependents[step]
        return resting

    def spent(self, step: int) -> int:
        """Return the bit that says that an irreversible step has been done; 0 for others."""
        return 1 << len(self) + self.once.index(step) if step in self.once else 0

    def meaning(self, combination: int) -> str:
        """Return in words: the achieved steps, those that cannot be done again, and whether one was stopped."""
        texts = [super().meaning(combination)]
        done = [i for i in self.once if combination & self.spent(i) and not combination >> i & 1]
        texts += [f"{self.steps[i].operation} cannot be done again" for i in done]
        return "; ".join(texts + ["stopped, and not known to be safe"] * bool(combination & self.stopped))

    def possible(self, step: int, combination: int) -> bool:
        """Return true if the step may be done.

        All its dependencies must be achieved, nothing at the patient may rest on it, and it must not be spent.

        Args:
            step: Index of the step.
            combination: Steps achieved, as bits.
        """
        barred = self.spent(step) | (self.stopped if self._guarded >> step & 1 else 0)
        barred |= self.dependents[step] & self.exposed
        return super().possible(step, combination) and not combination & barred

    def reopenable(self, step: int, combination: int) -> bool:
        """Return true if the step is achieved, and nothing at the patient rests on it."""
        return super().reopenable(step, combination) and not combination & self.dependents[step] & self.exposed

    def achieve(self, step: int, combination: int) -> int:
        """Return the combination after doing the step."""
        return super().achieve(step, combination) | self.spent(step)

    def failed(self, step: int, combination: int) -> int:
        """Return the combination after the step has failed: if it cannot be undone, a started step counts as done.

        Args:
            step: Index of the step.
            combination: Steps achieved before, as bits.
        """
        return self.interrupted(self.reopen(step, combination)) | self.spent(step)

    def interrupted(self, combination: int) -> int:
        """Return the combination after an interruption, when it is unknown what is at the patient."""
        return combination & ~self._resting | self.stopped

    def made_safe(self, combination: int) -> int:
        """Return the combination once nothing is at the patient."""
        return combination & ~self._resting & ~self.stopped

    def unsafe(self, combination: int) -> bool:
        """Return true if something is at the patient, or may be."""
        return bool(combination & (self.exposed | self.stopped))

    def allowable(self, step: int, combination: int) -> bool:
        """Return true if an irreversible step was done, and can be allowed again.

        Args:
            step: Index of the step.
            combination: Steps achieved, as bits.
        """
        barred = self.stopped | (1 << step | self.dependents[step]) & self.exposed
        return bool(combination & self.spent(step)) and not combination & barred

    def allow(self, step: int, combination: int) -> int:
        """Return the combination after an irreversible step is allowed again.

        Args:
            step: Index of the step.
            combination: Steps achieved before, as bits.
        """
        return self.reopen(step, combination) & ~self.spent(step)

    def fresh(self, combination: int) -> bool:
        """Return true if the branch can be restarted as a whole: nothing is at the patient, nothing is spent."""
        return not self.unsafe(combination) and not any(combination & self.spent(step) for step in self.once)

    def first_possible(self, step: int) -> int:
        """Return the smallest combination in which the step can be done."""
        closed = super().first_possible(step)
        return closed | sum(self.spent(i) for i in self.once if closed >> i & 1)

    def _reached(self) -> list[int]:
        """Return every combination that commands lead to, the start first."""
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
        """Return the combinations that one command leads to."""
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
    """Return true if it may fail on its way to or from the patient."""
    return hazard.counts and hazard.performed


def _bits(marks: Iterable[bool]) -> int:
    return sum(1 << i for i, marked in enumerate(marks) if marked)


def _members(bits: int) -> Iterator[int]:
    return (i for i in range(bits.bit_length()) if bits >> i & 1)
