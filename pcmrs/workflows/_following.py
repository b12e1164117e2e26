"""Following the body: the tool keeps its planned pose on a body that moves.

Where the joints shall be next, for the tool to keep its planned pose on a body that moves.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pcmrs.dispatcher import Activity as AnyActivity
from pcmrs.dispatcher import Registry
from pcmrs.dispatcher import Run as AnyRun
from pcmrs.errors import RefusalError
from pcmrs.kinematics.track import track
from pcmrs.spatial import Floats, Frame, Transform
from pcmrs.workflows._alignment import BODIES, AlignmentWatch, TrackerFrame, desired_in_body_ref, measured_from_desired
from pcmrs.workflows._body_track import BodyTrack
from pcmrs.workflows._collision_checks import ClearanceLimits, place_body, update_collision_scene
from pcmrs.workflows._correction import check_correctable
from pcmrs.workflows._placement import confirm_possible, target_pose
from pcmrs.workflows._setpoints import limit_twist
from pcmrs.workflows.cell import Cell
from pcmrs.workflows.data import PlacementData

Activity = AnyActivity[Cell, PlacementData]
Run = AnyRun[Cell, PlacementData]

FIRST_FRAMES = 10
"""Number of frames that must show tool and body before anything moves."""
FIRST_TIME = 5.0
"""Longest wait for these frames, s."""

MAX_ERROR, MAX_ERROR_ANGLE = 5e-4, float(np.radians(0.25))
"""Largest error that the integrator takes as the arm's, m and rad. A larger one is lag behind a fast body."""

MAX_OFFSET_TIME = 0.3
"""Time for which a tool may be seen too far from its place although nothing limits it, s. It is longer than the delay
of frames taken while the tool was catching up."""


class BodyFollower:
    """Computation of the joint positions with which the tool follows the body. It moves nothing itself.

    The tracker's pose is chosen so that the tool's pose by the joints agrees with the tracked one, which includes the
    error of the arm's geometry at the start. The remaining error, and the error that arises as the arm moves on, is
    integrated slowly from the tool's error against the body at one time of exposure.

    Args:
        cell: Cell with the arm at rest.
        data: Data of the procedure, with a registration and a plan in force.
        frames: Newest frames of a body that may move.

    Attributes:
        positions: Desired joint positions, rad, (n,).
        moved: Distance of the body from its place at the start, m.

    Raises:
        RefusalError: Tool or body are not seen, or the tool is too far from its place to go there by itself.
    """

    def __init__(self, cell: Cell, data: PlacementData, frames: Sequence[TrackerFrame]) -> None:
        self._cell, self._settings = cell, cell.settings.following
        desired = desired_in_body_ref(cell, data)
        if desired is None or data.registered is None:
            raise RefusalError(
                "not_registered", "There is no registration or no plan, so the tool cannot follow the body."
            )
        self._desired = desired
        graph = cell.frames(data)
        update_collision_scene(cell, data)
        self._base_from_tracker = graph.get(Frame.ROBOT_BASE, Frame.TRACKER)
        self._base_from_tool_tip = graph.get(Frame.ROBOT_BASE, Frame.TOOL_TIP)
        self._start = graph.get(Frame.TRACKER, Frame.REFERENCE).translation
        self._body = BodyTrack(self._settings)
        for frame in frames:
            self._body.take(frame)
            check_correctable(measured_from_desired(cell, frame, desired), cell.settings.placement)
        self._correction = Transform.identity()
        self._velocity: Floats = np.zeros(6)
        self._lagging = False
        self._offset_time = 0.0
        self.positions = cell.posture()
        self.moved = 0.0
        self._limits = ClearanceLimits.at_posture(cell, self.positions)

    def take(self, frame: TrackerFrame) -> Transform:
        """Take a frame, and return the tool's error in it, ``measured_from_desired``.

        Raises:
            RefusalError: The body or the tool jumped, or the arm's error is implausibly large.
        """
        elapsed = self._body.take(frame)
        error = measured_from_desired(self._cell, frame, self._desired)
        self._check_offset(error, elapsed)
        if not self._lagging:  # the error of a tool at its speed limit is lag, not an error of the arm
            gain = elapsed / self._settings.correction_time
            step = gain * limit_twist(_twist(error), MAX_ERROR, MAX_ERROR_ANGLE)
            self._correction = self._correction @ Transform.from_rotvec(step[:3], step[3:])
            check_correctable(self._correction, self._cell.settings.placement)
        return error

    def advance(self, time: float, elapsed: float) -> Floats:
        """Move on to the tool's pose at a time, and return the joint velocities of this step, rad/s, (n,).

        Args:
            time: Present time, s of the cell.
            elapsed: Time since the last call, s.

        Raises:
            RefusalError: The body is not seen or has gone too far, or the arm would be in a zone.
            UnreachableError: The arm cannot follow any farther.
        """
        stamp = self._body.stamp(time)
        tracker_from_body_ref = self._body.pose(stamp)
        self._check_range(tracker_from_body_ref)
        base_from_body_ref = self._base_from_tracker @ tracker_from_body_ref
        # The body's motion during this step. The tool makes it too, and catches up in addition.
        earlier = self._base_from_tracker @ self._body.pose(stamp - elapsed)
        self._move_tool(self._goal(earlier), self._goal(base_from_body_ref), elapsed)
        before, self.positions = self.positions, self._track()
        self._keep_out(base_from_body_ref)
        velocities: Floats = (self.positions - before) / elapsed
        return velocities

    def _check_offset(self, error: Transform, elapsed: float) -> None:
        """Refuse a tool that is seen off its place for too long; until then it is corrected by much less than 1 mm."""
        try:
            check_correctable(error, self._cell.settings.placement)
        except RefusalError:
            self._offset_time = 0.0 if self._lagging else self._offset_time + elapsed
            if self._offset_time > MAX_OFFSET_TIME:
                raise
        else:
            self._offset_time = 0.0

    def _check_range(self, tracker_from_body_ref: Transform) -> None:
        self.moved = float(np.linalg.norm(tracker_from_body_ref.translation - self._start))
        if self.moved > self._settings.range:
            text = (
                f"The body has moved by {self.moved * 1000:.0f} mm since the tool began to follow it; the limit is "
                f"{self._settings.range * 1000:g} mm. Back off, and approach again."
            )
            raise RefusalError("body_moved_far", text, moved=self.moved, limit=self._settings.range)

    def _goal(self, base_from_body_ref: Transform) -> Transform:
        """Return the ``base_from_tool_tip`` to command so that the tool is at its place on the body."""
        return base_from_body_ref @ self._desired @ self._correction

    def _move_tool(self, earlier: Transform, goal: Transform, elapsed: float) -> None:
        """Move the tool with the body, and smoothly to its place there, within the limits of its motion."""
        settings = self._settings
        with_body = _twist(earlier.inverse() @ goal) / elapsed
        catching_up = _twist(self._base_from_tool_tip.inverse() @ earlier) / max(settings.smoothing_time, elapsed)
        requested = with_body + catching_up
        limited = limit_twist(requested, settings.linear_velocity, settings.angular_velocity)
        max_change = settings.linear_acceleration * elapsed, settings.angular_acceleration * elapsed
        self._velocity = self._velocity + limit_twist(limited - self._velocity, *max_change)
        self._lagging = not np.allclose(self._velocity, requested)
        step = self._velocity * elapsed
        self._base_from_tool_tip = self._base_from_tool_tip @ Transform.from_rotvec(step[:3], step[3:])

    def _track(self) -> Floats:
        return track(self._cell.arm, self._cell.flange_for(self._base_from_tool_tip), self.positions)

    def _keep_out(self, base_from_body_ref: Transform) -> None:
        """Place the zones that move with the body. Raises `RefusalError` if the arm would be too near to a zone."""
        place_body(self._cell, self._base_from_tracker, base_from_body_ref)
        entered = self._limits.violation(self.positions)
        if entered is not None:
            raise entered


def _twist(transform: Transform) -> Floats:
    """Return the translation (m) and the rotation vector (rad) of a transform, (6,)."""
    return np.concatenate((transform.translation, transform.rotvec))


def follow_possible(run: Run) -> None:
    """Plan the straight path to the body's present place, and refuse one that is too long for a small correction."""
    cell = run.cell
    cell.check_streams("follow the body")
    image_from_tool_tip = cell.frames(run.data).get(Frame.IMAGE, Frame.TOOL_TIP)
    desired = target_pose(run.data, cell.settings.placement.confirm_offset)
    check_correctable(image_from_tool_tip.inverse() @ desired, cell.settings.placement)
    confirm_possible(run)


async def follow_head(act: Activity) -> None:
    """Send set points until the activity is cancelled, and end the stream then.

    Raises:
        RefusalError: See `BodyFollower`. The robot is then held.
        DeviceError: The robot has ended the stream itself.
    """
    cell, clock = act.cell, act.clock
    await cell.poses.collect(BODIES, FIRST_FRAMES, timeout=FIRST_TIME)
    frames = cell.poses.frames_after(0, BODIES)[-FIRST_FRAMES:]
    number = frames[-1]["coil"].frame_number
    follower, watch = BodyFollower(cell, act.data, frames), AlignmentWatch(act)
    async with cell.robot.servo() as stream:
        now = clock.monotonic()
        while True:
            for frame in cell.poses.frames_after(number, BODIES):
                number = frame["coil"].frame_number
                watch.take(frame, follower.take(frame))
            before, now = now, clock.monotonic()
            velocities = follower.advance(now, max(now - before, cell.settings.following.period))
            stream.send(follower.positions, velocities)
            watch.evaluate(moved_mm=round(follower.moved * 1000.0, 1))
            await clock.sleep(cell.settings.following.period)


def register_following(registry: Registry[Cell, PlacementData]) -> None:
    """Register the names that blueprints use for this check and activity."""
    registry.long_check(follow_possible)
    registry.activity(follow_head, moves=True)
