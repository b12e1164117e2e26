"""Guard of a moving arm: it is held if it drifts into a zone, or goes to a body that is no longer seen."""

from __future__ import annotations

import asyncio
import math
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager, suppress

from pcmrs.errors import RefusalError
from pcmrs.messages import JointState, JointTrajectory, MotionResult
from pcmrs.workflows._collision_checks import ClearanceLimits
from pcmrs.workflows.cell import Cell

BODY = "body_ref"

MAX_CHECK_INTERVAL = 0.1
"""Longest counted time between two checks, s. Measured joints arrive more often."""


async def follow_guarded(cell: Cell, trajectory: JointTrajectory, *, towards_body: bool) -> MotionResult:
    """Follow a trajectory under guard.

    Args:
        cell: Cell with robot and zones.
        trajectory: Planned path.
        towards_body: True if the tracker must show the body on the way.

    Raises:
        RefusalError: The arm was held, because it came nearer to a zone than planned or the body was not seen.
        DeviceError: The robot answered with a failure.
        UnknownOutcomeError: The robot did not answer.
    """
    async with guarded(cell, trajectory, towards_body=towards_body):
        return await cell.robot.follow(trajectory)


@asynccontextmanager
async def guarded(cell: Cell, trajectory: JointTrajectory, *, towards_body: bool) -> AsyncIterator[None]:
    """Guard a motion along a trajectory, or along a part of it, for as long as the context lasts.

    Args:
        cell: Cell with robot and zones.
        trajectory: Planned path.
        towards_body: True if the arm must be held when the tracker no longer shows the body. A retreat goes on.

    Raises:
        RefusalError: The arm was held, because it came nearer to a zone than planned or the body was not seen.
    """
    limits = await ClearanceLimits.along_motion(cell, trajectory.positions)
    guard = _Guard(cell, limits, _BodyVisibility(cell) if towards_body else None)
    cell.watchers.append(guard.watch)
    try:
        yield
    finally:
        cell.watchers.remove(guard.watch)
        await guard.wait_until_held()
    guard.check()


class _Guard:
    def __init__(self, cell: Cell, limits: ClearanceLimits, visibility: _BodyVisibility | None) -> None:
        self._cell = cell
        self._visibility = visibility
        self._limits = limits
        self._refusal: RefusalError | None = None
        self._holding: asyncio.Task[JointState] | None = None

    def watch(self, state: JointState) -> None:
        """Take measured joints, and hold the arm the first time that a link is too near or the body is lost."""
        if self._refusal is not None:
            return
        self._place_body()
        not_seen = None if self._visibility is None else self._visibility.refusal()
        self._refusal = self._limits.violation(state.positions) or not_seen
        if self._refusal is not None:
            # A watcher cannot wait, so the hold runs as a task until `wait_until_held`.
            self._holding = asyncio.get_running_loop().create_task(self._cell.robot.hold())

    async def wait_until_held(self) -> None:
        """Return once an arm that had to be held stands still."""
        if self._holding is not None:
            await self._holding

    def check(self) -> None:
        """Raise `RefusalError` if the arm was held."""
        if self._refusal is not None:
            raise self._refusal

    def _place_body(self) -> None:
        """Place the body where the tracker sees it now. While it is not seen, its last place counts."""
        cell = self._cell
        with suppress(RefusalError):
            seen = cell.poses.newest(BODY)
            body_ref_from_image = cell.body_ref_from_image or cell.earlier_body_ref_from_image
            if cell.base_from_tracker is not None and body_ref_from_image is not None:
                cell.zones.place_body(cell.base_from_tracker @ seen @ body_ref_from_image)


class _BodyVisibility:
    """Timer of how long the tracker has not shown the body, updated by every check.

    The time between two checks counts as `MAX_CHECK_INTERVAL` at most. If this process or the robot's messages were
    delayed, tracked poses wait to be taken, too.
    """

    def __init__(self, cell: Cell) -> None:
        self._cell = cell
        self._checked_at = cell.clock.monotonic()
        self._captured = -math.inf
        self._unseen = 0.0

    def refusal(self) -> RefusalError | None:
        """Return the refusal for an arm that must be held because the body is not seen; otherwise None."""
        cell, limit = self._cell, self._cell.settings.tracking.unseen
        now, captured = cell.clock.monotonic(), cell.poses.last_seen(BODY)
        # A new frame resets the timer to the age of the frame.
        if captured > self._captured and now - captured <= limit:
            self._captured, self._unseen = captured, min(now - captured, MAX_CHECK_INTERVAL)
        else:
            self._unseen += min(now - self._checked_at, MAX_CHECK_INTERVAL)
        self._checked_at = now
        if self._unseen <= limit:
            return None
        text = (
            f"The tracker has not shown the body for {self._unseen:.2f} s, limit {limit:g} s, and the arm was held on "
            "its way to it. Clear the line of visibility, then back off."
        )
        return RefusalError("body_not_seen", text, unseen=self._unseen, limit=limit)
