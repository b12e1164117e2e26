"""Present faults of the robot: its cabinet, its link and its arm."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np

from pcmrs.messages import DeviceEvent

if TYPE_CHECKING:
    from pcmrs_sim.arm import Arm
    from pcmrs_sim.kinematic_arm import KinematicArm

Framing = Literal["mixed", "split", "merged", "whole"]
"""Division of replies into TCP segments: some split or merged; all split; as many as possible merged; one in each."""

LARGEST_DEVIATION = 0.02
"""Deviation of a joint from its commanded position beyond which a moving arm is held, rad."""


@dataclass
class RobotFaults:
    """Present faults; the virtual cabinet and the simulated robot act on them.

    Attributes:
        cut: The link carries nothing.
        silent: Commands are executed and not answered.
        drives_off: Reason for which the drives are off; None while they are on.
        framing: Division of replies into TCP segments.
        doubled: Each line arrives twice.
        drops: Number of times the cabinet has closed the connection.
        restarts: Number of times its application was restarted at the pendant.
        refusing: Connections and motions are refused.
        servo_option: The controller has the option that set points need; without it no servo starts.
        late: The last set point arrives once more after the next connection.
    """

    cut: bool = False
    silent: bool = False
    drives_off: str | None = None
    framing: Framing = "whole"
    doubled: bool = False
    drops: int = 0
    restarts: int = 0
    refusing: bool = False
    servo_option: bool = True
    late: bool = False


def hold_if_deviating(arm: Arm | KinematicArm) -> None:
    """Brake a moving arm that deviates from its commanded posture, and raise the alarm once."""
    if arm.reference.ended or arm.stopped:
        return
    deviation = float(np.abs(arm.positions - arm.reference.position).max())
    if deviation <= LARGEST_DEVIATION:
        return
    arm.hold("pose_differs")
    text = f"The robot brakes: a joint is {deviation:.3f} rad from its commanded position, limit {LARGEST_DEVIATION:g}."
    text += " Look at the arm before you continue."
    arm.alarms.append(DeviceEvent(device="robot", code="pose_differs", text=text, danger=True))
