"""Times of the zones: all link pairs of one control step, the check of a whole approach, and the plan of a correction.

Run: ``python benchmarks/zones.py [STEPS]``. The cell is that of ``ratms`` as shipped: an iiwa 14, a coil, the hull of
the head phantom, the table and both lines of sight. A correction is the short line by which a placement is corrected
from the tracker; the planning process plans it.
"""

from __future__ import annotations

import os
import sys
import time

import msgspec
import numpy as np

from pcmrs.kinematics.arms import IIWA14_R820
from pcmrs.kinematics.limits import MotionLimits
from pcmrs.kinematics.model import ArmModel
from pcmrs.kinematics.straight import straight_motion
from pcmrs.spatial import Floats, Transform
from pcmrs.workflows.mounting import Mounting
from pcmrs.workflows.settings import ProcedureSettings
from pcmrs.workflows.surface import read_surface
from pcmrs.workflows.zones import CellZones

STEPS = 5_000
REPEATS = 5
"""Number of repetitions of every step, of which the fastest counts, to exclude other load of the machine."""
CORRECTIONS = 50
LONGEST_CORRECTION = ProcedureSettings().placement.correction_limit_mm * 1e-3
"""Longest plausible correction, m."""
TRACKER, BODY_REF = (1.35, -0.5, 0.6), (0.572, -0.006, 0.085)
BASE_FROM_IMAGE = Transform.from_quat_wxyz((0.462, 0.004, -0.015), (0.70710678, 0.0, 0.0, -0.70710678))
AT_HEAD = (0.014, 0.530, -0.003, -1.955, -0.019, 0.670, -1.543)
"""Posture with the coil at the vertex."""


def timed(zones: CellZones, posture: Floats) -> float:
    """Return the time to compute all distances once, us.

    Args:
        zones: Zones of the cell.
        posture: Joint positions, rad.
    """
    begin = time.perf_counter()
    zones.model.distances(posture)
    return (time.perf_counter() - begin) * 1e6


def timed_corrections(zones: CellZones, settings: ProcedureSettings, flange_from_tool_tip: Transform) -> Floats:
    """Return the times to plan the longest plausible corrections at the head, in random directions, ms.

    Args:
        zones: Zones of the cell.
        settings: Settings of the procedure.
        flange_from_tool_tip: Pose of the tool's contact point in the flange frame.
    """
    arm, motion, rng, times = ArmModel(IIWA14_R820), settings.motion, np.random.default_rng(2), []
    limits = MotionLimits(
        joint_velocity=tuple(motion.joint_speed_fraction * arm.velocity),
        joint_acceleration=(motion.joint_acceleration,) * arm.joints,
        joint_jerk=(motion.joint_jerk,) * arm.joints,
        linear_velocity=min(motion.linear_velocity, motion.near_velocity),
        linear_acceleration=motion.linear_acceleration,
        linear_jerk=motion.linear_jerk,
        angular_velocity=motion.angular_velocity,
        angular_acceleration=motion.angular_acceleration,
    )

    def speed_limit_at(postures: Floats) -> Floats:
        near = zones.near_body(postures, motion.near_distance)
        return np.where(near, motion.near_velocity, motion.linear_velocity)

    here = arm.forward(np.array(AT_HEAD))
    for _ in range(CORRECTIONS):
        direction = rng.normal(size=3)
        shift = LONGEST_CORRECTION * direction / np.linalg.norm(direction)
        goal = Transform(here.rotation, here.translation + shift)
        begin = time.perf_counter()
        tool = flange_from_tool_tip
        straight_motion(arm, AT_HEAD, goal, limits, flange_from_tool=tool, speed_limit_at=speed_limit_at)
        times.append((time.perf_counter() - begin) * 1e3)
    return np.array(times)


def main(steps: int) -> None:
    """Measure and print."""
    settings = msgspec.convert({"body": {"surface": "head_phantom.ply"}}, ProcedureSettings)
    mounting = Mounting.read(settings.calibration)
    flange_from_tool_tip = mounting.flange_from_tool_tip
    zones = CellZones(IIWA14_R820, mounting, settings, read_surface(settings))
    zones.place_body(BASE_FROM_IMAGE)
    zones.model.set_sight_lines(TRACKER, BODY_REF)
    home, at_head = np.array(IIWA14_R820.home), np.array(AT_HEAD)
    arm = ArmModel(IIWA14_R820)
    rng = np.random.default_rng(1)
    print(f"{os.cpu_count()} processors, {len(zones.model.pairs)} pairs, {steps} control steps")
    near = at_head + rng.uniform(-0.1, 0.1, (steps, 7))
    anywhere = rng.uniform(arm.lower, arm.upper, (steps, 7))
    along = home + np.linspace(0.0, 1.0, steps)[:, None] * (at_head - home)
    for name, postures in (("along an approach", along), ("near the head", near), ("anywhere", anywhere)):
        microseconds = []
        for posture in postures:
            microseconds.append(min(timed(zones, posture) for _ in range(REPEATS)))
        middle, high = np.percentile(microseconds, (50, 99))
        print(f"{name:20s} p50 {middle:6.1f} us   p99 {high:6.1f} us   limit 100 us")
    begin = time.perf_counter()
    looks = len(zones.sample_clearance(along[:: max(1, steps // 1000)]).postures)
    print(f"{'a whole approach':20s} {looks} looks in {(time.perf_counter() - begin) * 1e3:.1f} ms")
    p50, most = np.percentile(timed_corrections(zones, settings, flange_from_tool_tip), (50, 100))
    print(f"{'a correction':20s} p50 {p50:6.1f} ms   max {most:6.1f} ms")


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else STEPS)
