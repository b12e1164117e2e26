"""Faults of the robot: cabinet, link and arm."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, get_args

import numpy as np

from pcmrs.errors import DeviceError
from pcmrs.kinematics.limits import MotionLimits
from pcmrs.kinematics.model import ArmModel
from pcmrs.kinematics.trajectory import joint_motion
from pcmrs.messages import DeviceEvent
from pcmrs_sim.faults.fault import Fault, FaultTarget, choice, number, switch
from pcmrs_sim.robot_faults import Framing

LARGEST_OFFSET = 0.5
"""Largest offset of a joint, rad."""
PLAY = 1e-3
"""Distance from a joint's stop at which a hand ends, rad."""
LARGEST_PUSH = 100.0
"""Largest push on the tool, N."""
HAND_SPEED = 0.3
"""Speed at which a hand guides a joint, rad/s."""


def _cut(cell: FaultTarget, arguments: Mapping[str, Any]) -> None:
    cell.cut_robot(switch(arguments, "on"))


def _silent(cell: FaultTarget, arguments: Mapping[str, Any]) -> None:
    cell.robot_faults.silent = switch(arguments, "on")


def _interrupt(cell: FaultTarget, _arguments: Mapping[str, Any]) -> None:
    cell.world.arm.hold("interrupted")


def _frame(cell: FaultTarget, arguments: Mapping[str, Any]) -> None:
    cell.robot_faults.framing = choice(arguments, "how", get_args(Framing))


def _drives(reason: str) -> Callable[[FaultTarget, Mapping[str, Any]], None]:
    def apply(cell: FaultTarget, arguments: Mapping[str, Any]) -> None:
        if switch(arguments, "on"):
            cell.robot_faults.drives_off = reason
            cell.world.arm.hold(reason)
            cell.world.arm.alarms.append(_alarm(reason))
        elif cell.robot_faults.drives_off == reason:
            cell.robot_faults.drives_off = None

    return apply


def _offset(cell: FaultTarget, arguments: Mapping[str, Any]) -> None:
    offset = cell.world.arm.disturbance.offset.copy()
    offset[_joint(cell, arguments)] = number(arguments, "angle", -LARGEST_OFFSET, LARGEST_OFFSET)
    cell.world.arm.disturbance.offset = offset


def _guide(cell: FaultTarget, arguments: Mapping[str, Any]) -> None:
    arm = cell.world.arm
    if not arm.reference.ended:
        raise DeviceError("The arm moves; it can be guided by hand only while it rests.")
    goal = np.array(arm.reference.position)
    guided = _joint(cell, arguments)
    joint = cell.facts.joints[guided]
    angle = number(arguments, "angle", -LARGEST_OFFSET, LARGEST_OFFSET)
    # A hand turns no joint beyond its stop.
    goal[guided] = np.clip(goal[guided] + angle, joint.lower + PLAY, joint.upper - PLAY)
    arm.follow(joint_motion(ArmModel(cell.facts), arm.reference.position, goal, _hand_limits(len(goal))))


def _drop(cell: FaultTarget, _arguments: Mapping[str, Any]) -> None:
    cell.robot_faults.drops += 1


def _double(cell: FaultTarget, arguments: Mapping[str, Any]) -> None:
    cell.robot_faults.doubled = switch(arguments, "on")


def _refuse(cell: FaultTarget, arguments: Mapping[str, Any]) -> None:
    cell.robot_faults.refusing = switch(arguments, "on")


def _late(cell: FaultTarget, arguments: Mapping[str, Any]) -> None:
    cell.robot_faults.late = switch(arguments, "on")


def _servo(cell: FaultTarget, arguments: Mapping[str, Any]) -> None:
    cell.robot_faults.servo_option = not switch(arguments, "on")


def _push(cell: FaultTarget, arguments: Mapping[str, Any]) -> None:
    cell.world.arm.disturbance.push = number(arguments, "force", -LARGEST_PUSH, LARGEST_PUSH)


def _restart(cell: FaultTarget, _arguments: Mapping[str, Any]) -> None:
    cell.robot_faults.restarts += 1


def _alarm(reason: str) -> DeviceEvent:
    text = f"The robot's drives are off: {reason}. Release them at the robot."
    return DeviceEvent(device="robot", code="drives_off", text=text, danger=True, fields={"reason": reason})


def _joint(cell: FaultTarget, arguments: Mapping[str, Any]) -> int:
    joints = len(cell.facts.joints)
    joint = number(arguments, "joint", 1, joints)
    if joint != round(joint):
        raise DeviceError(f"The joint is {joint:g}, must be a whole number from 1 to {joints}.", joint=joint)
    return round(joint) - 1


def _hand_limits(joints: int) -> MotionLimits:
    """Return the limits of a motion that a hand guides."""
    return MotionLimits((HAND_SPEED,) * joints, (1.0,) * joints, (10.0,) * joints, 0.5, 1.0, 10.0, 1.0, 2.0)


FAULTS = (
    Fault("cut_robot", "B1", "The robot's link carries nothing; the arm brakes by itself.", ("on",), _cut),
    Fault("silence_robot", "B2", "The robot executes its commands and never answers.", ("on",), _silent),
    Fault("interrupt", "B3", 'The motion is interrupted; the cabinet says "interrupted".', (), _interrupt),
    Fault("frame_replies", "B4", "Replies are mixed, split, merged or whole in their segments.", ("how",), _frame),
    Fault("e_stop", "B5", "Emergency stop: the arm brakes; no motion starts until it is released.", ("on",),
          _drives("e_stop")),
    Fault("offset_joint", "B7", "A joint deviates from its commanded position by this angle, rad; 0 ends it.",
          ("joint", "angle"), _offset),
    Fault("change_mode", "B8", "The operating mode is changed: motion ends; none starts until it is changed back.",
          ("on",), _drives("mode_change")),
    Fault("close_brakes", "B8", "The brakes close: motion ends; none starts until they are open.", ("on",),
          _drives("brakes_closed")),
    Fault("guide_by_hand", "B9", "A person moves a joint of the resting arm by this angle, rad.", ("joint", "angle"),
          _guide),
    Fault("refuse_robot", "B10", "The robot refuses connections and motions.", ("on",), _refuse),
    Fault("drop_client", "B11", "The cabinet's application fails and closes the connection.", (), _drop),
    Fault("late_set_point", "B12", "The last set point arrives again after the next connection.", ("on",), _late),
    Fault("double_commands", "B13", "Each command arrives at the cabinet twice.", ("on",), _double),
    Fault("push_tool", "B14", "A collision: a force pushes the tool along its +z, N; 0 ends it.",
          ("force",), _push, also=("S13",)),
    Fault("withdraw_servo", "B15", "The controller has no servo option: no stream of set points starts.",
          ("on",), _servo),
    Fault("restart_cabinet", "B11", "A person restarts the cabinet's application at its pendant.", (), _restart),
)  # fmt: skip
"""Faults of the robot, for the registry `pcmrs_sim.faults.FAULTS`."""
