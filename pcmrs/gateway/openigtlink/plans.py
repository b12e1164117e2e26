"""Commands from Slicer: its plans, one after the other, and Stop.

A plan is checked as a whole and converted from mm to m, or refused with the reason.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any
from uuid import uuid4

import numpy as np
import numpy.typing as npt
import structlog

from pcmrs.background import BackgroundTasks
from pcmrs.devices.plus.messages import rigid
from pcmrs.errors import PcmrsError, RefusalError
from pcmrs.gateway._adapter import Core
from pcmrs.gateway.commands import PlanKind
from pcmrs.gateway.handlers import PlanLock
from pcmrs.gateway.rejection_log import RejectionLog
from pcmrs.messages import Command, Verdict

NEAREST_MM = 1.0
"""Limit of a target's distance to the image's origin, mm: a nearer one is in m by mistake, or a new transform."""
FARTHEST_MM = 1000.0
SMALLEST_MM = 5.0
"""Limit of the extent of all landmarks, mm: smaller ones are in m by mistake."""
FEWEST, MOST = 3, 100
OPERATIONS = {PlanKind.POSE: ("toolplan", "plan"), PlanKind.LANDMARKS: ("registration", "plan_landmarks")}

log = structlog.get_logger(__name__)


def target(matrix_mm: npt.ArrayLike) -> dict[str, Any]:
    """Return the arguments of ``toolplan.plan`` from the matrix (4, 4), mm, of the planned tool in the image.

    Raises:
        RefusalError: The matrix is not a rigid transform, or cannot be in mm.
    """
    image_from_coil = rigid(matrix_mm)
    _check_near(image_from_coil.translation * 1e3)
    distance_mm = float(np.linalg.norm(image_from_coil.translation)) * 1e3
    if distance_mm < NEAREST_MM:
        text = f"The target is {distance_mm:.3g} mm from the image's origin, the limit is {NEAREST_MM:g} mm. "
        text += "Is it a new, empty transform, or in metres? OpenIGTLink has millimetres."
        raise RefusalError("wrong_unit", text, value=distance_mm, limit=NEAREST_MM)
    return {"position": image_from_coil.translation.tolist(), "quat_xyzw": image_from_coil.quat_xyzw.tolist()}


def landmarks(positions_mm: Sequence[Sequence[float]], names: Sequence[str]) -> dict[str, Any]:
    """Return the arguments of ``registration.plan_landmarks``.

    Args:
        positions_mm: Points in the image, mm, (n, 3).
        names: Their names; a point with an empty name gets one.

    Raises:
        RefusalError: There are too few or too many points, a number is not finite, or they cannot be in mm.
    """
    if not FEWEST <= len(positions_mm) <= MOST:
        text = f"{len(positions_mm)} points were sent; a plan has {FEWEST} to {MOST} landmarks."
        raise RefusalError("wrong_count", text, count=len(positions_mm), fewest=FEWEST, most=MOST)
    points = np.array(positions_mm, dtype=float)
    if not np.isfinite(points).all():
        raise RefusalError("not_finite", "A landmark holds a number that is not finite; place it again.")
    _check_near(points)
    extent_mm = float(np.linalg.norm(np.ptp(points, axis=0)))
    if extent_mm < SMALLEST_MM:
        text = f"All landmarks lie within {extent_mm:.3g} mm, the limit is {SMALLEST_MM:g} mm. "
        text += "Are they in metres? OpenIGTLink has millimetres."
        raise RefusalError("wrong_unit", text, value=extent_mm, limit=SMALLEST_MM)
    named = zip(names, (points * 1e-3).tolist(), strict=True)
    return {"landmarks": [{"name": name or f"p{i}", "position": point} for i, (name, point) in enumerate(named)]}


def _check_near(points_mm: npt.NDArray[np.float64]) -> None:
    farthest_mm = float(np.abs(points_mm).max())
    if farthest_mm > FARTHEST_MM:
        text = f"A coordinate is {farthest_mm:.6g} mm from the image's origin, the limit is {FARTHEST_MM:g} mm."
        raise RefusalError("wrong_unit", text, value=farthest_mm, limit=FARTHEST_MM)


@dataclass(frozen=True, slots=True)
class PlanOutcome:
    """Outcome of a command; `code` and `text` say why it was not accepted."""

    decision: str
    operation: str
    code: str = ""
    text: str = ""

    @property
    def line(self) -> str:
        """Return one line of text for people."""
        head = f"{self.decision} {self.operation}"
        return f"{head} {self.code}: {self.text}" if self.code else head


@dataclass(frozen=True, slots=True)
class Attempt:
    """Plan to be submitted; `number` is its number in the plan lock."""

    number: int
    arguments: Callable[[], dict[str, Any]]


class PlanSubmitter:
    """Submitter of plans and Stop for one peer. It has no motions, but its plans lock the approaches of its host.

    While a plan is being decided, the newest of each kind waits; earlier ones are superseded and never submitted.

    Args:
        source: Source of the peer's commands in the journal.
        core: The daemon.
        lock: Plan lock of the peer's host.
        tasks: Owner of its tasks.
        answer: Called with the outcome of each command.
        refusals: Log of commands that are refused before they get to the daemon.
    """

    def __init__(
        self,
        source: str,
        core: Core,
        lock: PlanLock,
        tasks: BackgroundTasks,
        answer: Callable[[PlanOutcome], None],
        refusals: RejectionLog,
    ) -> None:
        self._source = source
        self._core = core
        self._lock = lock
        self._tasks = tasks
        self._answer = answer
        self._refusals = refusals
        self._waiting: dict[PlanKind, Attempt] = {}
        self._working = False

    def plan(self, kind: PlanKind, arguments: Callable[[], dict[str, Any]]) -> None:
        """Begin a plan; never waits.

        Args:
            kind: Kind of the plan.
            arguments: Returns the operation's arguments, or raises `RefusalError`.
        """
        self._waiting[kind] = Attempt(self._lock.attempt(kind), arguments)
        if not self._working:
            self._working = True
            self._tasks.spawn(self._work())

    def stop(self) -> None:
        """Stop everything at once, ahead of all that waits."""
        self._tasks.spawn(self._stop())

    def halt(self) -> None:
        """Reject the plans that wait, because of Stop."""
        for kind in self._waiting:
            self._answer(self._rejected(".".join(OPERATIONS[kind]), "stopped", "Stop came before it was decided."))
        self._waiting.clear()

    async def _work(self) -> None:
        while self._waiting:
            kind = next(iter(self._waiting))
            self._answer(await self._decide(kind, self._waiting.pop(kind)))
        self._working = False

    async def _decide(self, kind: PlanKind, attempt: Attempt) -> PlanOutcome:
        """Return the answer to a plan, however it ends."""
        branch, operation = OPERATIONS[kind]
        name = f"{branch}.{operation}"
        try:
            verdict = await self._core.submit(
                Command(
                    id=uuid4().hex, branch=branch, operation=operation, source=self._source, role="planner",
                    arguments=attempt.arguments(),
                )
            )  # fmt: skip
        except RefusalError as refusal:
            return self._rejected(name, refusal.refusal_code, refusal.text)
        except PcmrsError as error:
            return PlanOutcome("failed", name, error.code, error.text)
        except Exception:
            log.exception("plan_broke", operation=name)
            return PlanOutcome("failed", name, "internal_error", "The daemon's log has the details.")
        if verdict.decision == "accepted":
            self._lock.accept(kind, attempt.number)
        return _answer_of(verdict)

    def _rejected(self, name: str, reason: str, text: str) -> PlanOutcome:
        self._refusals.add(self._source, reason, f"{name} was refused: {text}")
        return PlanOutcome("rejected", name, reason, text)

    async def _stop(self) -> None:
        stands = await self._core.stop(self._source)
        text = "The robot has not confirmed that it stands."
        self._answer(
            PlanOutcome("accepted", "stop") if stands else PlanOutcome("failed", "stop", "hold_not_confirmed", text)
        )


def _answer_of(verdict: Verdict) -> PlanOutcome:
    name = f"{verdict.branch}.{verdict.operation}"
    if verdict.decision == "accepted":
        return PlanOutcome("accepted", name)
    if verdict.reason is None:
        return PlanOutcome(verdict.decision, name, verdict.decision)
    return PlanOutcome(verdict.decision, name, verdict.reason.code, verdict.reason.text)
