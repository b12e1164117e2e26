"""The main loop of the cabinet's application: tool frame, motions, servo, and most of the questions."""

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
IMPEDANCE_PART = 0.1
"""Of the arm's speed and acceleration that the servo with impedance uses."""
STIFFNESS = (5000.0, 300.0)
"""Greatest stiffness in translation, N/m, and in rotation, N m/rad, that the cabinet takes."""

QUESTIONS: dict[str, Callable[[Readings], list[float]]] = {
    "Eef_pos": Readings.pose,
    "Eef_force": Readings.force,
    "Eef_moment": Readings.moment,
    "Torques_ext_J": Readings.external_torques,
    "Torques_m_J": Readings.torques,
}

log = structlog.get_logger(__name__)


@dataclass
class Targets:
    """What the client has sent last: joints, rad, (7,), and a pose, x, y, z in mm and A, B, C in rad, (6,)."""

    joints: Floats = field(default_factory=lambda: np.zeros(JOINTS))
    pose: Floats = field(default_factory=lambda: np.zeros(6))


@dataclass
class _Motion:
    """What keeps the loop busy.

    Attributes:
        reference: What the arm follows for it; when the arm follows another one, the motion was broken off.
        end: What is answered when the arm has come to rest.
        over: It is being ended.
    """

    reference: SetPoint
    end: str
    over: bool = False


class MainLoop:
    """Works on one line at a time, and not while the arm moves for one.

    Args:
        cell: Its arm is moved.
        targets: Where motions go.
        readings: What is told.
        send: Takes the answers.

    Attributes:
        slot: The line to work on next.
    """

    def __init__(self, cell: CellSimulation, targets: Targets, readings: Readings, send: Callable[[str], None]) -> None:
        self._arm, self._faults, self._facts = cell.world.arm, cell.robot_faults, cell.facts
        self._settings = cell.world.settings.arm
        self._model = ArmModel(cell.facts)
        self._targets, self._readings, self._send = targets, readings, send
        self._speed = 0.0  # relative for joints, mm/s along lines
        self._motion: _Motion | None = None
        self.slot = ""
        self._acts: dict[str, Callable[[str], None]] = {
            "TFtrans": self._attach_tool,
            "jRelVel": self._set_speed,
            "doPTPinJS": self._move_joints,
            "doPTPinCS": self._move_straight,
            "startDirectServoJoints": self._start_servo,
            "startSmartImpedneceJoints": self._start_impedance,
        }

    def knows(self, line: str) -> bool:
        """Whether the loop would ever act on a line."""
        return line in QUESTIONS or _name(line) in self._acts

    def work(self) -> None:
        """Acts on the slot, unless the arm moves."""
        if self._motion is not None or not self.slot:
            return
        line, self.slot = self.slot, ""
        try:
            if self._faults.refusing:
                raise DeviceError("Its application refuses everything.")
            if line in QUESTIONS:
                self._send(reply(QUESTIONS[line](self._readings)))
            else:
                self._acts[_name(line)](line)
        except (PcmrsError, ValueError) as error:
            log.warning("cabinet_refuses", line=line, reason=str(error))
            self._send(NAK)

    def update(self) -> None:
        """Looks whether the arm has ended its motion, or was made to."""
        motion = self._motion
        if motion is None:
            return
        if not motion.over and self._arm.reference is not motion.reference:
            motion.over, motion.end = True, ""
            log.warning("cabinet_motion_broken_off", reason=self._arm.stopped)
            self._send(INTERRUPTED if self._arm.stopped == "interrupted" else NAK)
        servo = isinstance(motion.reference, Destination)
        if self._arm.reference.ended if servo else self._arm.at_rest:  # a servo is not waited for until it has settled
            self._motion = None
            if not servo:
                self.slot = ""  # what came during a point-to-point motion is lost
            self._send(motion.end)
            self.work()

    def servo(self) -> None:
        """Goes for new joints of the targets, if a servo runs."""
        if self._motion is not None and not self._motion.over and isinstance(self._motion.reference, Destination):
            self._motion.reference.take(self._targets.joints.copy())

    def stop_servo(self) -> None:
        """Ends a servo; a point-to-point motion goes on."""
        motion = self._motion
        if motion is not None and not motion.over and isinstance(motion.reference, Destination):
            motion.over = True
            self._arm.hold(None)

    def leave(self) -> None:
        """Nobody listens any more: the arm brakes."""
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
        """Mass, centre of mass (3), stiffness in translation, rotation and null space; the rest reads as zero.

        The compliance itself is not simulated. As in the real server, the target of joint 1 is what was sent last,
        not where it is; and what ends the servo is acknowledged a second time.
        """
        self._check_ready()
        _mass, *_centre, linear, angular, null_space = (*numbers(line), *(0.0,) * JOINTS)[:JOINTS]
        self._send(DONE)
        if not (0.0 <= linear <= STIFFNESS[0] and 0.0 <= angular <= STIFFNESS[1] and null_space >= 0.0):
            self._send(DONE)  # its failure is only logged
            return
        self._targets.joints[1:] = self._readings.joints()[1:]
        self._follow_targets(IMPEDANCE_PART, DONE)
        self.servo()

    def _follow_targets(self, part: float, end: str) -> None:
        servo = Destination(self._arm.reference.position, self._facts, self._settings, part)
        self._arm.track(servo)
        self._motion = _Motion(servo, end)

    def _check_ready(self) -> None:
        if self._faults.drives_off is not None:
            raise DeviceError(f"The drives are off: {self._faults.drives_off}.", reason=self._faults.drives_off)
        if not self._arm.reference.ended:
            raise DeviceError("The arm is moved by somebody else.")


def _name(line: str) -> str:
    return line.partition("_")[0]
