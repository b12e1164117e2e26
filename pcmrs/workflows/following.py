"""Following the body: the tool keeps its planned pose on a body that moves."""

from __future__ import annotations

from pcmrs.dispatcher import Activity as AnyActivity
from pcmrs.dispatcher import Registry
from pcmrs.dispatcher import Run as AnyRun
from pcmrs.spatial import Frame
from pcmrs.workflows.alignment import BODIES, AlignmentWatch
from pcmrs.workflows.cell import Cell
from pcmrs.workflows.correction import check_correctable
from pcmrs.workflows.data import PlacementData
from pcmrs.workflows.follower import Follower
from pcmrs.workflows.placement import confirm_possible, target

Activity = AnyActivity[Cell, PlacementData]
Run = AnyRun[Cell, PlacementData]

FIRST_FRAMES = 10
"""So many show where all is before anything moves."""
FIRST_TIME = 5.0
"""They come within this, s."""


def follow_possible(run: Run) -> None:
    """Plans the straight way to where the body is now; refuses one that is too long for a small correction."""
    cell = run.cell
    image_from_coil = cell.frames(run.data).get(Frame.IMAGE, Frame.COIL)
    desired = target(run.data, cell.settings.placement.confirm_offset)
    check_correctable(image_from_coil.inverse() @ desired, cell.settings.placement)
    confirm_possible(run)


async def follow_head(act: Activity) -> None:
    """Sends set points for as long as it is not told to end, and ends the stream before it does.

    Raises:
        RefusalError: See `Follower`: the robot is held then.
        DeviceError: The robot has ended the stream by itself.
    """
    cell, clock = act.cell, act.clock
    await cell.poses.collect(BODIES, FIRST_FRAMES, timeout=FIRST_TIME)
    known = cell.poses.frames_after(0, BODIES)[-FIRST_FRAMES:]
    number = known[-1]["coil"].frame_number
    follower, watch = Follower(cell, act.data, known), AlignmentWatch(act)
    async with cell.robot.servo() as stream:
        now = clock.monotonic()
        while True:
            for frame in cell.poses.frames_after(number, BODIES):
                number = frame["coil"].frame_number
                watch.take(frame, follower.take(frame))
            before, now = now, clock.monotonic()
            velocities = follower.advance(now, max(now - before, cell.settings.following.period))
            stream.send(follower.positions, velocities)
            watch.look(moved_mm=round(follower.moved * 1000.0, 1))
            await clock.sleep(cell.settings.following.period)


def register_following(registry: Registry[Cell, PlacementData]) -> None:
    """Registers the names that blueprints use for this check and activity."""
    registry.long_check(follow_possible)
    registry.activity(follow_head, moves=True)
