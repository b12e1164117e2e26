"""The main loop of the cabinet's application: tool frame, motions, servo, and most queries."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
import structlog

from pcmrs.devices.motion.reference import SetPoint
from pcmrs.errors import DeviceError, PcmrsError, UnreachableError
from pcmrs.kinematics.model import ArmModel
from pcmrs.messages import JointTrajectory
from pcmrs.spatial import Floats, Transform
from pcmrs_sim.cell import CellSimulation
from pcmrs_sim.kst.destination import Destination, VelocityDestination
from pcmrs_sim.kst.java import numbers, reply
from pcmrs_sim.kst.moves import circular_move, joint_move, servo_posture, straight_move
from pcmrs_sim.kst.readings import Readings, from_xyzabc, to_xyzabc

DONE, NAK, INTERRUPTED = "done\n", "nak\n", "interrupted\n"
JOINTS = 7
IMPEDANCE_FRACTION = 0.1
"""Fraction of the arm's speed and acceleration that the servo with impedance uses."""
LARGEST_STIFFNESS = (5000.0, 300.0)
"""Largest stiffness that the cabinet accepts, in translation, N/m, and in rotation, N m/rad."""

QUERIES: dict[str, Callable[[Readings], list[float]]] = {
    "Eef_pos": Readings.pose,
    "Eef_force": Readings.force,
    "Eef_moment": Readings.moment,
    "Torques_ext_J": Readings.external_torques,
    "Torques_m_J": Readings.torques,
}
"""Queries, each with the reading in its reply."""
NOT_SIMULATED = ("handGuiding", "preciseHandGuiding", "doPTP!")
"""First letters of lines that the real server processes and this one refuses."""

log = structlog.get_logger(__name__)


@dataclass
class Targets:
    """Targets that the client has sent last.

    Attributes:
        joints: Posture, rad, (7,).
        velocities: Velocities of the joints in a servo, rad/s, (7,).
        pose: Pose of the tool frame in the base: x, y, z in mm and A, B, C in rad, (6,). A relative motion uses
            x, y, z.
        servo_pose: The same in a servo.
        circle_middle: The same on the way of a circle.
        circle_end: The same at the end of a circle.
    """

    joints: Floats = field(default_factory=lambda: np.zeros(JOINTS))
    velocities: Floats = field(default_factory=lambda: np.zeros(JOINTS))
    pose: Floats = field(default_factory=lambda: np.zeros(6))
    servo_pose: Floats = field(default_factory=lambda: np.zeros(6))
    circle_middle: Floats = field(default_factory=lambda: np.zeros(6))
    circle_end: Floats = field(default_factory=lambda: np.zeros(6))


@dataclass
class _Motion:
    """A motion or servo session that keeps the loop busy.

    Attributes:
        reference: Reference of the arm. If the arm follows another one, the motion was interrupted.
        reply: Reply when the arm is at rest.
        follow: Passes new targets to the reference of a servo; None for a point-to-point motion.
        ending: The motion is being ended.
    """

    reference: SetPoint
    reply: str
    follow: Callable[[], None] | None = None
    ending: bool = False


class MainLoop:
    """Loop that processes one line at a time, and none while the arm moves for it.

    Args:
        cell: The running cell, whose arm it moves.
        targets: Targets of the motions.
        readings: Measurements in its replies.
        send: Called with each reply.

    Attributes:
        slot: The line to process next; empty for none.
    """

    def __init__(self, cell: CellSimulation, targets: Targets, readings: Readings, send: Callable[[str], None]) -> None:
        self._arm, self._faults, self._facts = cell.world.arm, cell.robot_faults, cell.facts
        self._settings = cell.world.settings.arm
        self._model = ArmModel(cell.facts)
        self._targets, self._readings, self._send = targets, readings, send
        self._speed = 0.0  # a fraction for motions of the joints, mm/s for motions along a line
        self._motion: _Motion | None = None
        self.slot = ""
        self._handlers: dict[str, Callable[[str], None]] = {
            "TFtrans": self._attach_tool,
            "jRelVel": self._set_speed,
            "doPTPinJS": self._move_joints,
            "doPTPinCSRelEEF": self._move_in_tool,
            "doPTPinCSRelBase": self._move_in_base,
            "doPTPinCSCircle1": self._move_on_circle,
            "doPTPinCS": self._move_straight,
            "startDirectServoJoints": self._start_servo,
            "stDcEEf_": self._start_pose_servo,
            "stVelDcJoint_": self._start_velocity_servo,
            "startSmartImpedneceJoints": self._start_impedance,
            **dict.fromkeys(NOT_SIMULATED, self._refuse),
        }

    def accepts(self, line: str) -> bool:
        """Return true if the loop knows the request of a line."""
        return line in QUERIES or self._handler(line) is not None

    def process_slot(self) -> None:
        """Process the line in the slot, unless the arm moves."""
        if self._motion is not None or not self.slot:
            return
        line, self.slot = self.slot, ""
        handler = self._handler(line)
        try:
            if self._faults.refusing:
                raise DeviceError("Its application refuses everything.")
            if handler is not None:
                handler(line)
            else:
                self._send(reply(QUERIES[line](self._readings)))
        except (PcmrsError, ValueError) as error:
            log.warning("cabinet_refuses", line=line, reason=str(error))
            self._send(NAK)

    def update(self) -> None:
        """Check whether the arm has ended its motion, or was interrupted, and reply."""
        motion = self._motion
        if motion is None:
            return
        if not motion.ending and self._arm.reference is not motion.reference:
            motion.ending, motion.reply = True, ""
            log.warning("cabinet_motion_broken_off", reason=self._arm.stopped)
            self._send(INTERRUPTED if self._arm.stopped == "interrupted" else NAK)
        servo = motion.follow is not None
        # The end of a servo does not wait until the arm has settled.
        if self._arm.reference.ended if servo else self._arm.at_rest:
            self._motion = None
            if not servo:
                self.slot = ""  # a line that came during a point-to-point motion is lost
            self._send(motion.reply)
            self.process_slot()

    def update_servo(self) -> None:
        """Pass the new targets to the servo, if one runs."""
        if self._motion is not None and not self._motion.ending and self._motion.follow is not None:
            self._motion.follow()

    def stop_servo(self) -> None:
        """End a servo. A point-to-point motion continues."""
        motion = self._motion
        if motion is not None and not motion.ending and motion.follow is not None:
            motion.ending = True
            self._arm.hold(None)

    def leave(self) -> None:
        """Brake the arm because the client has gone."""
        if self._motion is not None:
            self._arm.hold("link_lost")
            self._motion = None

    def _handler(self, line: str) -> Callable[[str], None] | None:
        """Return the handler whose name begins the line, as the real server compares; None if there is none."""
        return next((handler for name, handler in self._handlers.items() if line.startswith(name)), None)

    def _refuse(self, line: str) -> None:
        raise DeviceError("The virtual cabinet does not simulate this request.", request=line)

    def _attach_tool(self, line: str) -> None:
        values = numbers(line)
        if len(values) != 6:
            raise DeviceError(f"A tool frame needs 6 numbers, not {len(values)}.", count=len(values))
        self._readings.flange_from_tool = from_xyzabc(values)
        self._send(DONE)

    def _set_speed(self, line: str) -> None:
        self._speed = (numbers(line) or [0.0])[0]
        self._send(DONE)

    def _move_joints(self, _line: str) -> None:
        self._check_ready()
        self._send(DONE)
        self._move(joint_move(self._model, self._arm.reference.position, self._targets.joints, self._speed))

    def _move_straight(self, _line: str) -> None:
        self._move_tool(lambda _start: from_xyzabc(self._targets.pose.tolist()))

    def _move_in_base(self, _line: str) -> None:
        self._move_tool(lambda start: Transform(start.rotation, start.translation + self._offset()))

    def _move_in_tool(self, _line: str) -> None:
        self._move_tool(lambda start: start @ Transform(np.eye(3), self._offset()))

    def _offset(self) -> Floats:
        """Return the way of a relative motion, m, (3,)."""
        return from_xyzabc(self._targets.pose.tolist()).translation

    def _move_tool(self, goal: Callable[[Transform], Transform]) -> None:
        """Move the tool frame on a line to the pose that `goal` returns for its present one, both in the base."""
        self._check_ready()
        self._send(DONE)
        start, tool = self._arm.reference.position, self._readings.flange_from_tool
        base_from_tool = goal(self._model.forward(start) @ tool)
        self._move(straight_move(self._model, start, base_from_tool, tool, self._speed * 1e-3))

    def _move_on_circle(self, _line: str) -> None:
        self._check_ready()
        self._send(DONE)
        start, tool = self._arm.reference.position, self._readings.flange_from_tool
        middle, end = (
            from_xyzabc(values.tolist()) for values in (self._targets.circle_middle, self._targets.circle_end)
        )
        self._move(circular_move(self._model, start, middle, end, tool, self._speed * 1e-3))

    def _move(self, trajectory: JointTrajectory) -> None:
        self._arm.follow(trajectory)
        self._motion = _Motion(self._arm.reference, DONE)

    def _start_servo(self, _line: str) -> None:
        self._check_servo_ready()
        self._send(DONE)
        self._targets.joints[:] = self._readings.joints()
        self._follow_targets(1.0, "")

    def _start_pose_servo(self, _line: str) -> None:
        self._check_servo_ready()
        self._send(DONE)
        start, tool = self._arm.reference.position, self._readings.flange_from_tool
        self._targets.servo_pose[:] = to_xyzabc(self._model.forward(start) @ tool)
        servo = Destination(start, self._facts, self._settings)

        def follow() -> None:
            pose = from_xyzabc(self._targets.servo_pose.tolist())
            try:
                servo.take(servo_posture(self._model, pose, tool, servo.target))
            except (DeviceError, UnreachableError) as error:
                log.warning("cabinet_set_point_refused", reason=error.text)
                servo.halt = "unreachable"

        self._track(servo, "", follow)

    def _start_velocity_servo(self, _line: str) -> None:
        self._check_servo_ready()
        self._send(DONE)
        self._targets.velocities[:] = 0.0
        servo = VelocityDestination(self._arm.reference.position, self._facts, self._settings)
        self._track(servo, "", lambda: servo.take(self._targets.velocities.copy()))

    def _start_impedance(self, line: str) -> None:
        """Start a servo with impedance.

        The numbers are mass, centre of mass (3), and stiffness in translation, rotation and null space. Missing ones
        are zero. The compliance itself is not simulated. As in the real server, the target of joint 1 is the one that
        was sent last, and not its position; and the end of the servo is acknowledged a second time.
        """
        self._check_servo_ready()
        _mass, *_centre, linear, angular, null_space = (*numbers(line), *(0.0,) * JOINTS)[:JOINTS]
        self._send(DONE)
        largest_linear, largest_angular = LARGEST_STIFFNESS
        if not (0.0 <= linear <= largest_linear and 0.0 <= angular <= largest_angular and null_space >= 0.0):
            self._send(DONE)  # the real server only logs the failure
            return
        self._targets.joints[1:] = self._readings.joints()[1:]
        self._follow_targets(IMPEDANCE_FRACTION, DONE)
        self.update_servo()

    def _follow_targets(self, fraction: float, end_reply: str) -> None:
        servo = Destination(self._arm.reference.position, self._facts, self._settings, fraction)
        self._track(servo, end_reply, lambda: servo.take(self._targets.joints.copy()))

    def _track(self, servo: SetPoint, end_reply: str, follow: Callable[[], None]) -> None:
        self._arm.track(servo)
        self._motion = _Motion(servo, end_reply, follow)

    def _check_ready(self) -> None:
        if self._faults.drives_off is not None:
            raise DeviceError(f"The drives are off: {self._faults.drives_off}.", reason=self._faults.drives_off)
        if not self._arm.reference.ended:
            raise DeviceError("The arm is already moving.")

    def _check_servo_ready(self) -> None:
        self._check_ready()
        if not self._faults.servo_option:
            raise DeviceError("The controller has no servo option.")
