"""What is wrong with the robot now: its cabinet, its link and its arm."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np

from pcmrs.messages import DeviceEvent

if TYPE_CHECKING:
    from pcmrs_sim.arm import Arm
    from pcmrs_sim.kinematic_arm import KinematicArm

Framing = Literal["mixed", "split", "merged", "whole"]
"""How replies lie in segments: now and then split or merged; always split; merged as far as can be; one in one."""

MOST_BESIDE = 0.02
"""An arm that moves is held when a joint is farther than this from where it was told to be, rad."""


@dataclass
class RobotFaults:
    """What is wrong now; the virtual cabinet and the simulated robot look here.

    Attributes:
        cut: The link carries nothing.
        silent: Commands are carried out and not answered.
        drives_off: Why the drives are off, if they are.
        framing: How replies lie in segments.
        doubled: Every line arrives twice.
        drops: How often the cabinet closed the connection so far.
        restarts: How often its application was started again at the pendant so far.
        refusing: It refuses to be connected or moved.
        late: The last set point arrives once more when somebody connects again.
    """

    cut: bool = False
    silent: bool = False
    drives_off: str | None = None
    framing: Framing = "mixed"
    doubled: bool = False
    drops: int = 0
    restarts: int = 0
    refusing: bool = False
    late: bool = False


def hold_beside(arm: Arm | KinematicArm) -> None:
    """Brakes an arm that has moved beside where it was told to be, and raises the alarm, once."""
    if arm.reference.ended or arm.stopped:
        return
    beside = float(np.abs(arm.positions - arm.reference.position).max())
    if beside <= MOST_BESIDE:
        return
    arm.hold("pose_differs")
    text = f"The robot brakes: a joint is {beside:.3f} rad from where it was told to be, limit {MOST_BESIDE:g}."
    text += " Look at the arm before going on."
    arm.alarms.append(DeviceEvent(device="robot", code="pose_differs", text=text, danger=True))
