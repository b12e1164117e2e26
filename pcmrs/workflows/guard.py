"""Watches the measured joints while the arm moves, and holds it where it drifts into a zone."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager, suppress

from pcmrs.errors import RefusalError
from pcmrs.messages import JointState, JointTrajectory, MotionResult
from pcmrs.workflows.cell import Cell
from pcmrs.workflows.floors import Floors


async def follow_guarded(cell: Cell, trajectory: JointTrajectory) -> MotionResult:
    """Follows a trajectory, watched.

    Raises:
        RefusalError: The arm was held, since it came nearer to a zone than planned.
        DeviceError: The robot answered with a failure.
        UnknownOutcomeError: It did not answer.
    """
    async with guarded(cell, trajectory):
        return await cell.robot.follow(trajectory)


@asynccontextmanager
async def guarded(cell: Cell, trajectory: JointTrajectory) -> AsyncIterator[None]:
    """Watches a motion along a trajectory, or along a part of it, for as long as the context lasts.

    Raises:
        RefusalError: The arm was held, since it came nearer to a zone than planned.
    """
    guard = _Guard(cell, trajectory)
    cell.watchers.append(guard.watch)
    try:
        yield
    finally:
        cell.watchers.remove(guard.watch)
        await guard.held()
    guard.check()


class _Guard:
    def __init__(self, cell: Cell, trajectory: JointTrajectory) -> None:
        self._cell = cell
        self._floors = Floors(cell, trajectory.positions)
        self._entered: RefusalError | None = None
        self._holding: asyncio.Task[JointState] | None = None

    def watch(self, state: JointState) -> None:
        """Takes measured joints, and holds the arm the first time that a link is too near."""
        if self._entered is not None:
            return
        self._place_body()
        self._entered = self._floors.passed(state.positions)
        if self._entered is not None:
            self._holding = asyncio.get_running_loop().create_task(self._cell.robot.hold())

    async def held(self) -> None:
        """Returns once an arm that had to be held stands."""
        if self._holding is not None:
            await self._holding

    def check(self) -> None:
        """Raises `RefusalError` where the arm was held."""
        if self._entered is not None:
            raise self._entered

    def _place_body(self) -> None:
        """Takes where the tracker sees the body now; while it does not, the body counts as where it was."""
        cell = self._cell
        with suppress(RefusalError):
            seen = cell.poses.newest("body_ref")
            if cell.base_from_tracker is not None and cell.body_ref_from_image is not None:
                cell.zones.place_body(cell.base_from_tracker @ seen @ cell.body_ref_from_image)
