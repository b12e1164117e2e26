"""What is known of a tool that a teleoperator guides: who is heard, where the body is, how it goes.

Where the joints shall be next, for the tool to move as a teleoperator asks, within limits.
"""

from __future__ import annotations

import math
from typing import Literal

import numpy as np
import numpy.typing as npt

from pcmrs.dispatcher import Activity as AnyActivity
from pcmrs.errors import RefusalError, UnreachableError
from pcmrs.kinematics.track import track
from pcmrs.kinematics.zones import MOUNT, TOOL
from pcmrs.messages import TeleopSetpoint, TeleopStatus
from pcmrs.messages.teleop import Limit
from pcmrs.spatial import Floats, Frame, Transform
from pcmrs.workflows.alignment import BODIES, desired_in_body_ref
from pcmrs.workflows.body_track import BodyTrack
from pcmrs.workflows.cell import Cell
from pcmrs.workflows.collision_checks import place_body, update_collision_scene
from pcmrs.workflows.data import PlacementData
from pcmrs.workflows.following import FIRST_FRAMES
from pcmrs.workflows.setpoints import Admission, within
from pcmrs.workflows.toolplan import PlanLimits
from pcmrs.workflows.zones import BODY


class Guide:
    """Integrates twists into a pose of the tool, and follows that with the joints; moves nothing itself.

    A step that would lead over a limit is not made: the tool stands, and may go back. Zones are kept as on any other
    way; where the tool may touch the body, it comes no nearer to it than at the planned contact. What is already
    nearer may only go away.

    Args:
        cell: With the arm at rest and its zones arranged.
        base_from_plan: Where the planned pose is, nudges included.

    Attributes:
        positions: Where the joints shall be, rad, (n,).
        limit: What has kept the tool from its last step, if anything.

    Raises:
        UnreachableError: The arm cannot go from here to the planned contact.
    """

    def __init__(self, cell: Cell, base_from_plan: Transform) -> None:
        self._cell, self._settings = cell, cell.settings.teleoperation
        self._limits = PlanLimits(self._settings)
        self.positions = cell.posture()
        self._base_from_tool = cell.arm.forward(self.positions) @ cell.flange_from_coil
        contact = track(cell.arm, cell.flange_for(base_from_plan), self.positions)
        self._at_contact = cell.zones.model.distances(contact)
        self._touching = np.array([pair in ((TOOL, BODY), (MOUNT, BODY)) for pair in cell.zones.model.pairs])
        self._velocity: Floats = np.zeros(6)
        self._base_from_plan = base_from_plan
        self.limit: Limit | None = None

    @property
    def plan_from_tool(self) -> Transform:
        """Where the tool is by its planned pose."""
        return self._base_from_plan.inverse() @ self._base_from_tool

    def begin(self) -> None:
        """Takes the arm as it stands."""
        self.positions = self._cell.posture()
        self._base_from_tool = self._cell.arm.forward(self.positions) @ self._cell.flange_from_coil
        self._velocity = np.zeros(6)

    def see(self, base_from_plan: Transform) -> None:
        """Takes where the planned pose is now; the zones are placed alike."""
        self._base_from_plan = base_from_plan

    def advance(self, twist: Floats, scale: float, passed: float) -> Floats:
        """Goes on towards a twist.

        Args:
            twist: In the tool's frame, m/s and rad/s, (6,); what is over the limits of speed is shortened.
            scale: Part of that speed that is left, 0 to 1.
            passed: Since the last call, s.

        Returns:
            The joint velocities that lead there, rad/s, (n,).
        """
        settings, pose = self._settings, self.plan_from_tool
        wanted = scale * within(twist, settings.linear_velocity, settings.angular_velocity)
        wanted = self._limits.bounded(pose, wanted, passed)
        most = settings.linear_acceleration * passed, settings.angular_acceleration * passed
        changed = self._velocity + within(wanted - self._velocity, *most)
        self._velocity = self._limits.bounded(pose, changed, passed)
        self.limit = self._limits.met(pose) if np.any(twist) else None
        before = self.positions
        if np.any(self._velocity):
            self._step(self._velocity * passed)
        return np.asarray((self.positions - before) / passed)

    def _step(self, way: Floats) -> None:
        """Goes a way (6,), m and rad, where nothing is against it; stands otherwise."""
        base_from_tool = self._base_from_tool @ Transform.from_rotvec(way[:3], way[3:])
        positions, against = self._look_at(base_from_tool)
        if against is None:
            self._base_from_tool, self.positions = base_from_tool, positions
        else:
            self._velocity, self.limit = np.zeros(6), self.limit or against

    def _look_at(self, base_from_tool: Transform) -> tuple[Floats, Limit | None]:
        """The joints for a pose of the tool, and what is against it."""
        plan_from_tool = self._base_from_plan.inverse() @ base_from_tool
        if not self._limits.allow(self.plan_from_tool, plan_from_tool):
            return self.positions, self._limits.met(plan_from_tool) or "range"
        try:
            positions = track(self._cell.arm, self._cell.flange_for(base_from_tool), self.positions)
        except UnreachableError:
            return self.positions, "reach"
        return positions, self._zone_against(positions, base_from_tool)

    def _zone_against(self, positions: Floats, base_from_tool: Transform) -> Literal["zone"] | None:
        zones = self._cell.zones
        limits = zones.limits_towards(self._base_from_plan, base_from_tool.translation[None])[0]
        limits = self._with_contact(limits)
        here, there = zones.model.distances(self.positions), zones.model.distances(positions)
        nearer = bool(np.any((there < limits) & (there < here)))
        return "zone" if nearer or self._leaves_cone(base_from_tool) else None

    def _leaves_cone(self, base_from_tool: Transform) -> bool:
        """Whether the tool point goes out of the cone in which alone it comes to the body, or farther out of it."""
        points = np.array((self._base_from_tool.translation, base_from_tool.translation))
        here, there = self._cell.zones.cone.excess(self._base_from_plan, points).tolist()
        return bool(there > 0.0 and there > here)

    def _with_contact(self, limits: npt.NDArray[np.float64]) -> Floats:
        """The limits of all pairs, m, (P,); what may touch the body comes as near as at the planned contact."""
        return np.where(self._touching & np.isinf(limits), self._at_contact, limits)


Activity = AnyActivity[Cell, PlacementData]

FIRST = 1.0
"""The first set point may take so much longer than the others, s: until then nothing moves."""
TELL_EVERY = 0.02
"""Between two statuses, s: as often as set points come."""


class Guiding:
    """Follows set points and the body, and waits for nothing.

    Args:
        act: On whose behalf; the arm is at rest.

    Attributes:
        guide: Says where the joints shall be.

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
        base_from_body_ref = graph.get(Frame.ROBOT_BASE, Frame.BODY_REF)
        self.guide = Guide(cell, base_from_body_ref @ self._body_ref_from_plan)
        self._body = BodyTrack(cell.settings.following)
        self._frame_number = 0
        self._admission: Admission | None = None
        self._heard = self._told = -math.inf

    @property
    def wanted(self) -> str | None:
        """User whose set points the workflow wants to count; None while the clutch is open."""
        return self._act.data.teleoperator if self._act.states["teleoperation"] == "engaged" else None

    def engage(self, user: str) -> None:
        """The clutch has been engaged: the arm stands, and set points count from now on."""
        act, cell = self._act, self._act.cell
        now = act.clock.monotonic()
        self._admission = Admission(user, now, self._settings)
        self._heard = now + FIRST
        self._body = BodyTrack(cell.settings.following)
        known = cell.poses.frames_after(0, BODIES)[-FIRST_FRAMES:]
        self._frame_number = known[0]["coil"].frame_number - 1 if known else 0
        self.guide.begin()

    def release(self) -> None:
        """The clutch has been opened."""
        self._admission = None

    def hear(self, user: str, setpoint: TeleopSetpoint) -> None:
        """Takes a set point the moment it comes."""
        if self._admission is not None:
            self._admission.take(user, setpoint, self._act.clock.monotonic())

    def advance(self, now: float, passed: float) -> Floats:
        """Goes on as the newest set point asks; returns the joint velocities that lead there, rad/s, (n,).

        Args:
            now: s of the cell.
            passed: Since the last call, s.

        Raises:
            RefusalError: No fresh set point has come, tool and body are not seen, or the body has jumped.
        """
        admission = self._admission
        if admission is None:
            raise RefusalError("not_engaged", "The clutch is open: engage it first.")
        self._check_heard(admission, now)
        self._see_body(now)
        velocities = self.guide.advance(np.array(admission.twist), admission.scale.value, passed)
        if now - self._told >= TELL_EVERY:
            self.tell()
        return velocities

    def tell(self) -> None:
        """Publishes how it goes."""
        act, pose, admission = self._act, self.guide.plan_from_tool, self._admission
        self._told = act.clock.monotonic()
        status = TeleopStatus(
            stamp=self._told,
            distance=float(np.linalg.norm(pose.translation)),
            height=float(pose.translation[2]),
            turn=float(np.linalg.norm(pose.rotvec)),
        )
        act.cell.teleop.tell(status if admission is None else admission.shown(status, self.guide.limit))

    def _check_heard(self, admission: Admission, now: float) -> None:
        if admission.arrived is not None:
            self._heard = admission.arrived
        silence, limit = now - self._heard, self._settings.deadman
        if silence > limit:
            text = (
                f"No set point of {admission.user} was admitted for {silence:.3f} s, the limit is {limit:g} s "
                f"(refused: {dict(admission.refused) or 'none'}). Look at the cell, acknowledge there, then back off."
            )
            raise RefusalError("teleoperator_lost", text, user=admission.user, silence=silence, limit=limit)

    def _see_body(self, now: float) -> None:
        """Takes where the tracker sees the body: the plan and the zones go with it."""
        cell = self._act.cell
        for frame in cell.poses.frames_after(self._frame_number, BODIES):
            self._frame_number = frame["coil"].frame_number
            self._body.take(frame)
        base_from_body_ref = self._base_from_tracker @ self._body.pose(self._body.stamp(now))
        place_body(cell, self._base_from_tracker, base_from_body_ref)
        self.guide.see(base_from_body_ref @ self._body_ref_from_plan)


def planned_in_body_ref(cell: Cell, data: PlacementData) -> Transform:
    """``body_ref_from_coil`` as planned and nudged. Raises `RefusalError` where there is no plan or registration."""
    planned = desired_in_body_ref(cell, data)
    if planned is None:
        raise RefusalError("not_registered", "There is no registration and plan to guide the tool near.")
    return planned
