"""The main loop of the cabinet's application: tool frame, motions, servo, and most queries."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
import structlog

from pcmrs.devices.motion.reference import SetPoint
from pcmrs.errors import DeviceError, PcmrsError
from pcmrs.kinematics.model import ArmModel
from pcmrs.messages import JointTrajectory
from pcmrs.spatial import Floats
from pcmrs_sim.cell import CellSimulation
from pcmrs_sim.kst.destination import Destination
from pcmrs_sim.kst.java import numbers, reply
from pcmrs_sim.kst.moves import joint_move, straight_move
from pcmrs_sim.kst.readings import Readings, from_xyzabc

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

log = structlog.get_logger(__name__)


@dataclass
class Targets:
    """Targets that the client has sent last.

    Attributes:
        joints: Posture, rad, (7,).
        pose: Pose of the tool frame in the base: x, y, z in mm and A, B, C in rad, (6,).
    """

    joints: Floats = field(default_factory=lambda: np.zeros(JOINTS))
    pose: Floats = field(default_factory=lambda: np.zeros(6))


@dataclass
class _Motion:
    """A motion or servo session that keeps the loop busy.

    Attributes:
        reference: Reference of the arm. If the arm follows another one, the motion was interrupted.
        reply: Reply when the arm is at rest.
        ending: The motion is being ended.
    """

    reference: SetPoint
    reply: str
    ending: bool = False


class MainLoop:
    """Processes one line at a time, and none while the arm moves for it.

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
            "doPTPinCS": self._move_straight,
            "startDirectServoJoints": self._start_servo,
            "startSmartImpedneceJoints": self._start_impedance,
        }

    def accepts(self, line: str) -> bool:
        """Return true if the loop knows the request of a line."""
        return line in QUERIES or _name(line) in self._handlers

    def process_slot(self) -> None:
        """Process the line in the slot, unless the arm moves."""
        if self._motion is not None or not self.slot:
            return
        line, self.slot = self.slot, ""
        try:
            if self._faults.refusing:
                raise DeviceError("Its application refuses everything.")
            if line in QUERIES:
                self._send(reply(QUERIES[line](self._readings)))
            else:
                self._handlers[_name(line)](line)
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
        servo = isinstance(motion.reference, Destination)
        # The end of a servo does not wait until the arm has settled.
        if self._arm.reference.ended if servo else self._arm.at_rest:
            self._motion = None
            if not servo:
                self.slot = ""  # a line that came during a point-to-point motion is lost
            self._send(motion.reply)
            self.process_slot()

    def update_servo(self) -> None:
        """Pass the new joint target to the servo, if one runs."""
        if self._motion is not None and not self._motion.ending and isinstance(self._motion.reference, Destination):
            self._motion.reference.take(self._targets.joints.copy())

    def stop_servo(self) -> None:
        """End a servo. A point-to-point motion continues."""
        motion = self._motion
        if motion is not None and not motion.ending and isinstance(motion.reference, Destination):
            motion.ending = True
            self._arm.hold(None)

    def leave(self) -> None:
        """Brake the arm because the client has gone."""
        if self._motion is not None:
            self._arm.hold("link_lost")
            self._motion = None

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
        self._check_ready()
        self._send(DONE)
        start, goal, tool = self._arm.reference.position, self._targets.pose, self._readings.flange_from_tool
        self._move(straight_move(self._model, start, from_xyzabc(goal.tolist()), tool, self._speed * 1e-3))

    def _move(self, trajectory: JointTrajectory) -> None:
        self._arm.follow(trajectory)
        self._motion = _Motion(self._arm.reference, DONE)

    def _start_servo(self, _line: str) -> None:
        self._check_ready()
        self._send(DONE)
        self._targets.joints[:] = self._readings.joints()
        self._follow_targets(1.0, "")

    def _start_impedance(self, line: str) -> None:
        """Start a servo with impedance.

        The numbers are mass, centre of mass (3), and stiffness in translation, rotation and null space. Missing ones
        are zero. The compliance itself is not simulated. As in the real server, the target of joint 1 is the one that
        was sent last, and not its position; and the end of the servo is acknowledged a second time.
        """
        self._check_ready()
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
        self._arm.track(servo)
        self._motion = _Motion(servo, end_reply)

    def _check_ready(self) -> None:
        if self._faults.drives_off is not None:
            raise DeviceError(f"The drives are off: {self._faults.drives_off}.", reason=self._faults.drives_off)
        if not self._arm.reference.ended:
            raise DeviceError("The arm is already moving.")


def _name(line: str) -> str:
    return line.partition("_")[0]
