"""What every tracker driver does, whatever is behind it."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable, Sequence
from contextlib import aclosing
from itertools import pairwise

import numpy as np
import pytest
import pytest_asyncio

from pcmrs.devices.protocols import TrackerDriver
from pcmrs.messages import BodyPose
from pcmrs.spatial import Transform, rotation_angle
from pcmrs_sim.cell import CellSimulation
from pcmrs_sim.faults import inject
from pcmrs_sim.tracker_faults import BODIES
from tests.unit.devices.contract_trackers import TRACKERS

pytestmark = pytest.mark.asyncio(loop_scope="module")

QUIET = 0.5
"""A tracker that sends nothing for so long has stopped, s."""


@pytest_asyncio.fixture(scope="module", loop_scope="module", params=list(TRACKERS))
async def opened(request: pytest.FixtureRequest) -> AsyncIterator[tuple[Frames, CellSimulation]]:
    """One tracker for all tests: each ends the faults that it begins."""
    async with TRACKERS[request.param]() as (tracker, cell), Frames(tracker) as frames:
        yield frames, cell


@pytest_asyncio.fixture(loop_scope="module")
async def seen(opened: tuple[Frames, CellSimulation]) -> tuple[Frames, CellSimulation]:
    """A tracker that sees the tool in new frames."""
    frames, _ = opened
    frames.skip()
    await frames.until(lambda frame: frame["coil"].valid)
    return opened


class Frames:
    """What a tracker sends, read by a task as a node does."""

    def __init__(self, tracker: TrackerDriver) -> None:
        self._tracker = tracker
        self._queue: asyncio.Queue[Sequence[BodyPose]] = asyncio.Queue()

    async def __aenter__(self) -> Frames:
        self._task = asyncio.create_task(self._read())
        return self

    async def __aexit__(self, *_: object) -> None:
        self._task.cancel()
        await asyncio.gather(self._task, return_exceptions=True)

    async def _read(self) -> None:
        async with aclosing(self._tracker.frames()) as frames:  # type: ignore[type-var]
            async for frame in frames:
                self._queue.put_nowait(frame)

    @property
    def trouble(self) -> str:
        return self._tracker.trouble

    async def until_troubled(self) -> None:
        async with asyncio.timeout(10.0):
            while not self.trouble:  # noqa: ASYNC110 - what is waited for is no business of this loop
                await asyncio.sleep(0.02)

    def skip(self) -> None:
        """Forgets what has not been taken."""
        while not self._queue.empty():
            self._queue.get_nowait()

    async def next(self) -> dict[str, BodyPose]:
        return {pose.body: pose for pose in await self._queue.get()}

    async def take(self, count: int) -> list[dict[str, BodyPose]]:
        return [await self.next() for _ in range(count)]

    async def until(self, condition: Callable[[dict[str, BodyPose]], bool]) -> dict[str, BodyPose]:
        while not condition(frame := await self.next()):
            pass
        return frame

    async def until_quiet(self) -> None:
        while True:
            try:
                async with asyncio.timeout(QUIET):
                    await self._queue.get()
            except TimeoutError:
                return


def _transform(pose: BodyPose) -> Transform:
    return Transform.from_quat_wxyz(pose.position, pose.quat_wxyz)


async def test_frames_advance_and_hold_all_bodies(seen: tuple[Frames, CellSimulation]) -> None:
    frames, _ = seen
    taken = await frames.take(60)
    assert all(set(frame) == set(BODIES) for frame in taken)
    for body in BODIES:
        poses = [frame[body] for frame in taken]
        assert all(after.frame_number > before.frame_number for before, after in pairwise(poses))
        assert all(after.captured > before.captured for before, after in pairwise(poses))
        assert all(pose.captured <= pose.sent for pose in poses)
    assert all(len({pose.frame_number for pose in frame.values()}) == 1 for frame in taken)


async def test_poses_agree_with_the_truth_within_the_tracker_errors(seen: tuple[Frames, CellSimulation]) -> None:
    frames, cell = seen
    truth = cell.world.tracker_from("coil")
    assert truth is not None
    errors = [_transform(frame["coil"]) for frame in await frames.take(60)]
    # A bias of 0.10 mm and 0.03 deg rms over all places, and jitter of 0.03 mm and 0.02 deg per axis.
    offset = np.mean([pose.translation - truth.translation for pose in errors], axis=0)
    assert np.linalg.norm(offset) < 0.4e-3
    assert max(np.degrees(rotation_angle(pose, truth)) for pose in errors) < 0.2
    spread = np.std([pose.translation for pose in errors], axis=0)
    assert np.all(spread < 0.06e-3)


async def test_hidden_body_is_invalid_with_a_reason_and_others_are_not(seen: tuple[Frames, CellSimulation]) -> None:
    frames, cell = seen
    inject(cell, "occlude", {"body": "coil"})
    frame = await frames.until(lambda frame: not frame["coil"].valid)
    assert frame["coil"].reason in ("occluded", "missing")
    assert frame["body_ref"].valid
    inject(cell, "occlude", {"body": "coil", "on": False})
    assert (await frames.until(lambda frame: frame["coil"].valid))["coil"].reason is None


@pytest.mark.parametrize("reason", ["out_of_volume", "partially_out", "temperature", "interference"])
async def test_tracker_status_of_a_body_is_the_reason(seen: tuple[Frames, CellSimulation], reason: str) -> None:
    frames, cell = seen
    inject(cell, "not_measured", {"body": "coil", "reason": reason})
    assert (await frames.until(lambda frame: not frame["coil"].valid))["coil"].reason == reason
    inject(cell, "not_measured", {"body": "coil", "reason": reason, "on": False})
    await frames.until(lambda frame: frame["coil"].valid)


async def test_another_tool_than_the_defined_one_is_no_pose(seen: tuple[Frames, CellSimulation]) -> None:
    frames, cell = seen
    inject(cell, "wrong_tool", {"body": "coil"})
    frame = await frames.until(lambda frame: not frame["coil"].valid)
    assert frame["coil"].reason in ("wrong_tool", "missing")
    assert frame["body_ref"].valid
    inject(cell, "wrong_tool", {"body": "coil", "on": False})
    await frames.until(lambda frame: frame["coil"].valid)


async def test_an_unplugged_tracker_stops_and_recovers(seen: tuple[Frames, CellSimulation]) -> None:
    frames, cell = seen
    inject(cell, "tracker_unplugged", {"on": True})
    await frames.until_quiet()
    await frames.until_troubled()
    inject(cell, "tracker_unplugged", {"on": False})
    await frames.until(lambda frame: frame["coil"].valid)
    assert frames.trouble == ""


async def test_a_tracker_that_answers_nothing_stops_and_recovers(seen: tuple[Frames, CellSimulation]) -> None:
    frames, cell = seen
    inject(cell, "tracker_absent", {"on": True})
    await frames.until_quiet()
    await frames.until_troubled()
    inject(cell, "tracker_absent", {"on": False})
    await frames.until(lambda frame: frame["coil"].valid)
    assert frames.trouble == ""


async def test_a_frozen_frame_number_gives_no_valid_pose(seen: tuple[Frames, CellSimulation]) -> None:
    frames, cell = seen
    last = (await frames.next())["coil"].frame_number
    inject(cell, "frame_frozen", {"on": True})
    numbers = [last]
    while len(numbers) < 2 or numbers[-1] != numbers[-2]:
        pose = (await frames.next())["coil"]
        numbers.append(pose.frame_number)
    assert pose.reason == "frozen" or pose.valid, "the feed refuses a number that does not advance"
    inject(cell, "frame_frozen", {"on": False})
    await frames.until(lambda frame: frame["coil"].valid and frame["coil"].frame_number > numbers[-1])
