"""Gathering of poses on a running cell, with a progress bar for the operator."""

from __future__ import annotations

import math
from collections.abc import Awaitable, Callable, Sequence
from contextlib import suppress

import numpy as np
from rich.progress import BarColumn, Progress

from pcmrs.calibration.pose_collection import PoseCollection
from pcmrs.calibration.poses import write_poses
from pcmrs.cli.calibrate.options import LiveOptions
from pcmrs.cli.options import CellAddress
from pcmrs.cli.tables import Terminal
from pcmrs.clock import Clock, SystemClock
from pcmrs.devices.poses import PoseFeed
from pcmrs.errors import RefusalError
from pcmrs.kinematics.model import ArmModel
from pcmrs.kinematics.urdf_arms import find_arm
from pcmrs.messages import BodyPose, JointState
from pcmrs.spatial import Transform, distance, mean_transform, rotation_angle

MAX_AGE = 1.0
"""Largest age of a pose, s."""
SPREAD, PIVOT_STEP = math.radians(15.0), math.radians(2.0)
POSTURE_STEP = math.radians(5.0)
AT_REST = 1e-3
"""Joint velocity below which an arm stands still, rad/s."""
REST = 0.5
"""Time that an arm must have stood still, s: it vibrates for a while."""
FRAMES = 20
"""Tracker frames averaged per posture of the arm."""
MOVED, MOVED_TURN = 0.002, math.radians(0.5)
"""Largest motion of the reference in the tracker, m and rad: beyond it, it or the tracker was pushed."""


async def pivot_poses(address: CellAddress, live: LiveOptions) -> list[Transform]:
    """Return ``tracker_from_pointer`` while the operator pivots it.

    Args:
        address: The cell.
        live: Options of the gathering.

    Raises:
        BusError: No daemon answers.
        RefusalError: There are not enough poses.
    """
    clock = SystemClock()
    feed, collection = PoseFeed(clock, MAX_AGE), PoseCollection(live.count, SPREAD, PIVOT_STEP)

    async def another() -> None:
        with suppress(RefusalError):  # hidden for a moment
            (frame,) = await feed.collect(["pointer"], 1, timeout=MAX_AGE)
            if collection.is_new(frame["pointer"]):
                collection.poses.append(frame["pointer"])

    async with address.connect() as client:
        client.listen("state/pose/pointer", BodyPose, feed.update)
        await _collect(collection, live, clock, another, "Keep the tip in place and tilt the pointer to all sides")
    return collection.poses


async def hand_eye_poses(
    address: CellAddress, live: LiveOptions, robot: str
) -> tuple[list[Transform], list[Transform]]:
    """Return ``base_from_flange`` and ``tracker_from_tool_marker`` wherever the arm rests.

    Args:
        address: The cell.
        live: Options of the gathering.
        robot: Model of the arm.

    Raises:
        BusError: No daemon answers.
        RefusalError: There are not enough poses, the reference has moved, or the arm is of another model.
    """
    clock = SystemClock()
    arm, feed = _RestingArm(ArmModel(find_arm(robot)), clock), PoseFeed(clock, MAX_AGE)
    collection, seen = PoseCollection(live.count, SPREAD, POSTURE_STEP), list[dict[str, Transform]]()

    async def another() -> None:
        flange, since = arm.flange(), arm.since
        if flange is None or not collection.is_new(flange):
            await clock.sleep(0.05)
            return
        try:
            frames = await feed.collect(["coil", "body_ref"], FRAMES, timeout=5.0)
        except RefusalError:
            return  # hidden: another posture will do
        if arm.since == since:
            means = {body: mean_transform([frame[body] for frame in frames]) for body in ("coil", "body_ref")}
            seen.append(means)
            collection.poses.append(flange)
            _check_still(seen[0]["body_ref"], means["body_ref"])

    async with address.connect() as client:
        client.listen("state/pose/*", BodyPose, feed.update)
        client.listen("state/joints", JointState, arm.update)
        await _collect(collection, live, clock, another, "Bring the arm to another posture, and let it rest")
    return collection.poses, [means["coil"] for means in seen]


class _RestingArm:
    """Pose of the flange while the arm stands still.

    Args:
        arm: Model of the arm.
        clock: Clock of the cell.

    Attributes:
        since: Time of the last motion of the arm, s of the clock.
    """

    def __init__(self, arm: ArmModel, clock: Clock) -> None:
        self.since = clock.monotonic()
        self._arm = arm
        self._clock = clock
        self._positions: list[float] = []

    def update(self, state: JointState) -> None:
        """Take a newly measured joint state."""
        if state.moving or np.abs(state.velocities).max(initial=0.0) > AT_REST:
            self.since = self._clock.monotonic()
        self._positions = state.positions

    def flange(self) -> Transform | None:
        """Return ``base_from_flange``; None while no state is received, or the arm has not stood for `REST`.

        Raises:
            RefusalError: ``other_robot``: the joints are not those of the model.
        """
        wanted = len(self._arm.lower)
        if not self._positions or self._clock.monotonic() - self.since < REST:
            return None
        if len(self._positions) != wanted:
            text = f"The robot reports {len(self._positions)} joints, the model has {wanted}: name it with --robot."
            raise RefusalError("other_robot", text, joints=len(self._positions))
        return self._arm.forward(self._positions)


def save_poses(live: LiveOptions, names: Sequence[str], poses: Sequence[Sequence[Transform]]) -> None:
    """Save gathered poses, if the operator asked for it.

    Args:
        live: Options of the gathering.
        names: Name of each list of poses.
        poses: The lists.

    Raises:
        OSError: They cannot be written.
    """
    if live.save_to is not None:
        write_poses(live.save_to, names, poses)


def _check_still(first: Transform, now: Transform) -> None:
    moved, turned = distance(first, now), rotation_angle(first, now)
    if moved > MOVED or turned > MOVED_TURN:
        text = (
            f"The reference moved by {moved * 1000:.1f} mm and {math.degrees(turned):.2f}° in the tracker, the limits "
            f"are {MOVED * 1000:g} mm and {math.degrees(MOVED_TURN):g}°: fix it and the tracker to the robot's base, "
            "and restart."
        )
        raise RefusalError("reference_moved", text, moved=moved, turned=turned)


async def _collect(
    collection: PoseCollection, live: LiveOptions, clock: Clock, another: Callable[[], Awaitable[None]], prompt: str
) -> None:
    """Ask for one pose after the other until there are enough.

    Raises:
        RefusalError: ``not_enough_poses`` within the time.
    """
    with Progress("{task.description}", BarColumn(), console=Terminal(stderr=True)) as bar:
        task = bar.add_task(prompt, total=1.0)
        try:
            async with clock.timeout(live.seconds):
                while collection.progress < 1.0:
                    await another()
                    bar.update(task, completed=collection.progress, description=f"{prompt}: {collection}")
        except TimeoutError:
            text = f"After {live.seconds:g} s there are {collection}. {prompt}, and restart, or give more --seconds."
            raise RefusalError("not_enough_poses", text, poses=len(collection.poses)) from None
