"""Teleoperation: a user guides the tool near its planned pose while the clutch is engaged."""

from __future__ import annotations

import math

import numpy as np

from pcmrs.dispatcher import Activity as AnyActivity
from pcmrs.dispatcher import Registry
from pcmrs.dispatcher import Run as AnyRun
from pcmrs.errors import RefusalError
from pcmrs.messages import TeleopSetpoint, TeleopStatus
from pcmrs.spatial import Floats, Frame, Transform
from pcmrs.workflows._alignment import BODIES, desired_in_body_ref
from pcmrs.workflows._body_track import BodyTrack
from pcmrs.workflows._collision_checks import place_body, update_collision_scene
from pcmrs.workflows._following import FIRST_FRAMES, FIRST_TIME
from pcmrs.workflows._guided_tool import GuidedTool
from pcmrs.workflows._placement import check_at_present_plan
from pcmrs.workflows._setpoints import SetpointAdmission
from pcmrs.workflows.cell import Cell
from pcmrs.workflows.data import PlacementData

Activity = AnyActivity[Cell, PlacementData]
Run = AnyRun[Cell, PlacementData]

BUS = "bus:"
"""Prefix of the sources that can send set points."""

FIRST_SETPOINT_TIME = 1.0
"""Additional time for the first set point, s. Until then nothing moves."""
STATUS_INTERVAL = 0.02
"""Time between two statuses, s: the period of set points."""


class GuidanceSession:
    """Session of guidance that follows set points and the body, without ever waiting.

    Args:
        act: Activity that runs the session. The arm is at rest.

    Attributes:
        guide: Tool that is guided, with its desired joint positions.

    Raises:
        RefusalError: Tool or body are not seen, or there is no plan.
        UnreachableError: The arm cannot go from here to its planned pose.
    """

    def __init__(self, act: Activity) -> None:
        cell = act.cell
        self._act, self._settings = act, cell.settings.teleoperation
        self._body_ref_from_plan = planned_in_body_ref(cell, act.data)
        update_collision_scene(cell, act.data)
        graph = cell.frames(act.data)
        self._base_from_tracker = graph.get(Frame.ROBOT_BASE, Frame.TRACKER)
        base_from_body_ref = graph.get(Frame.ROBOT_BASE, Frame.REFERENCE)
        self.guide = GuidedTool(cell, base_from_body_ref @ self._body_ref_from_plan)
        self._body = BodyTrack(cell.settings.following)
        self._frame_number = 0
        self._admission: SetpointAdmission | None = None
        self._last_setpoint_at = self._published_at = -math.inf

    @property
    def engaged_user(self) -> str | None:
        """User whose set points the workflow admits; None while the clutch is open."""
        return self._act.data.teleoperator if self._act.states["teleoperation"] == "engaged" else None

    def engage(self, user: str) -> None:
        """Start to admit set points of a user, with the arm at rest."""
        act, cell = self._act, self._act.cell
        now = act.clock.monotonic()
        self._admission = SetpointAdmission(user, now, self._settings)
        # The teleoperator must see a status of this engagement before the first set point can be admitted.
        self._last_setpoint_at = now + FIRST_SETPOINT_TIME
        self._body = BodyTrack(cell.settings.following)
        frames = cell.poses.frames_after(0, BODIES)[-FIRST_FRAMES:]
        # The new track takes these frames again, so that it starts with the body's velocity.
        self._frame_number = frames[0]["coil"].frame_number - 1 if frames else 0
        self.guide.begin()

    def release(self) -> None:
        """Stop to admit set points, because the clutch is open."""
        self._admission = None

    def take_setpoint(self, user: str, setpoint: TeleopSetpoint) -> None:
        """Take a set point as soon as it arrives.

        Args:
            user: User who has sent the set point.
            setpoint: Set point.
        """
        if self._admission is not None:
            self._admission.take(user, setpoint, self._act.clock.monotonic())

    def advance(self, now: float, elapsed: float) -> Floats:
        """Move on with the newest set point, and return the joint velocities of this step, rad/s, (n,).

        Args:
            now: Present time, s of the cell.
            elapsed: Time since the last call, s.

        Raises:
            RefusalError: No recent set point has arrived, tool and body are not seen, or the body has jumped.
        """
        admission = self._admission
        if admission is None:
            raise RefusalError("not_engaged", "The clutch is open: engage it first.")
        self._check_deadman(admission, now)
        self._track_body(now)
        velocities = self.guide.advance(np.array(admission.twist), admission.scale.value, elapsed)
        if now - self._published_at >= STATUS_INTERVAL:
            self.publish_status()
        return velocities

    def publish_status(self) -> None:
        """Publish the status of the tool and of the set points."""
        act, pose, admission = self._act, self.guide.plan_from_tool, self._admission
        self._published_at = act.clock.monotonic()
        status = TeleopStatus(
            stamp=self._published_at,
            distance=float(np.linalg.norm(pose.translation)),
            height=float(pose.translation[2]),
            turn=float(np.linalg.norm(pose.rotvec)),
        )
        act.cell.teleop.publish(status if admission is None else admission.add_to(status, self.guide.limit))

    def _check_deadman(self, admission: SetpointAdmission, now: float) -> None:
        if admission.arrived is not None:
            self._last_setpoint_at = admission.arrived
        silence, limit = now - self._last_setpoint_at, self._settings.deadman
        if silence > limit:
            text = (
                f"No set point of {admission.user} was admitted for {silence:.3f} s, the limit is {limit:g} s "
                f"(refused: {dict(admission.refused) or 'none'}). Check the cell, acknowledge there, then back off."
            )
            raise RefusalError("teleoperator_lost", text, user=admission.user, silence=silence, limit=limit)

    def _track_body(self, now: float) -> None:
        """Place the body where the tracker sees it, with the plan and the zones."""
        cell = self._act.cell
        for frame in cell.poses.frames_after(self._frame_number, BODIES):
            self._frame_number = frame["coil"].frame_number
            self._body.take(frame)
        base_from_body_ref = self._base_from_tracker @ self._body.pose(self._body.stamp(now))
        place_body(cell, self._base_from_tracker, base_from_body_ref)
        self.guide.set_plan(base_from_body_ref @ self._body_ref_from_plan)


def planned_in_body_ref(cell: Cell, data: PlacementData) -> Transform:
    """Return ``body_ref_from_tool_tip`` as planned and nudged.

    Args:
        cell: Cell with the settings.
        data: Data of the procedure.

    Raises:
        RefusalError: There is no plan or registration.
    """
    planned = desired_in_body_ref(cell, data)
    if planned is None:
        raise RefusalError("not_registered", "There is no registration or no plan: both are needed to guide the tool.")
    return planned


def guide_possible(run: Run) -> None:
    """Refuse to guide a tool that is not seen with the body, or whose arm cannot go from here to the planned pose."""
    run.cell.check_streams("be guided")
    check_at_present_plan(run.data)
    cell = run.cell
    body_ref_from_plan = planned_in_body_ref(cell, run.data)
    update_collision_scene(cell, run.data)
    GuidedTool(cell, cell.frames(run.data).get(Frame.ROBOT_BASE, Frame.REFERENCE) @ body_ref_from_plan)


async def see_tool_and_body(run: Run) -> None:
    """Wait until tool and body have been seen together again. Raises `RefusalError` if they are not."""
    await run.cell.poses.collect(BODIES, FIRST_FRAMES, timeout=FIRST_TIME)


def engage_possible(run: Run) -> None:
    """Refuse users who cannot send set points, and an engagement while tool or body are hidden.

    Set points arrive over the bus, whose keys name the user.
    """
    if not run.command.source.startswith(BUS):
        text = f"Set points come over the bus, which {run.command.source} does not use: engage by `pcmrs teleop`."
        raise RefusalError("no_teleoperator", text, source=run.command.source)
    for body in BODIES:
        run.cell.poses.newest(body)


def keep_teleoperator(run: Run) -> None:
    """Admit the set points of the requesting user from now on, and of no other user."""
    run.keep(teleoperator=run.command.user)


async def teleoperate(act: Activity) -> None:
    """Move the tool as the engaged teleoperator commands; otherwise stand still, and wait for the clutch.

    Raises:
        RefusalError: See `GuidanceSession`. The robot is then held.
        DeviceError: The robot has ended the stream itself.
    """
    session = GuidanceSession(act)
    with act.cell.teleop.deliver_to(session.take_setpoint):
        while True:
            session.publish_status()
            if session.engaged_user is not None:
                await _while_engaged(act, session, session.engaged_user)
            await act.clock.sleep(STATUS_INTERVAL)


async def _while_engaged(act: Activity, session: GuidanceSession, user: str) -> None:
    """Send set points to the robot until this user's clutch is open, then end the stream, which brakes the arm."""
    clock, period = act.clock, act.cell.settings.teleoperation.period
    session.engage(user)
    async with act.cell.robot.servo() as stream:
        now = clock.monotonic()
        while session.engaged_user == user:
            before, now = now, clock.monotonic()
            velocities = session.advance(now, max(now - before, period))
            stream.send(session.guide.positions, velocities)
            await clock.sleep(period)
    session.release()


def register_teleoperation(registry: Registry[Cell, PlacementData]) -> None:
    """Register the names that blueprints use for these checks, steps and activity."""
    registry.long_check(guide_possible)
    registry.check(engage_possible)
    registry.world_step(see_tool_and_body)
    registry.step(keep_teleoperator)
    registry.activity(teleoperate, moves=True)
