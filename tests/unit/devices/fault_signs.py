"""Signs of the faults of the simulated cell: what a robot, a tracker or the world shows while a fault acts."""

from __future__ import annotations

import math
from collections.abc import Awaitable, Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np

from pcmrs.errors import DeviceError, PcmrsError
from pcmrs.messages import BodyPose, JointSetpoint
from pcmrs_sim.cell import CellSimulation

LOOK = 0.5
"""Time for which frames are watched, s: 30 frames at 60 Hz."""

Frame = Mapping[str, BodyPose]
Frames = Sequence[Frame]


async def connected(cell: CellSimulation) -> None:
    await cell.robot.connect()


async def in_servo(cell: CellSimulation) -> None:
    """Begins a session, which a fault interrupts; it would end by itself."""
    await connected(cell)
    await cell.robot.begin_servo()


@dataclass(frozen=True)
class Sign:
    """What shows a fault.

    Attributes:
        look: Measures something, with and without the fault.
        shows: Whether the second measurement, compared with the first, shows the fault.
        prepare: Brings the cell into the state in which the fault begins.
    """

    look: Callable[[CellSimulation], Awaitable[Any]]
    shows: Callable[[Any, Any], bool]
    prepare: Callable[[CellSimulation], Awaitable[None]] = connected


async def frames(cell: CellSimulation) -> Frames:
    """Frames that the tracker publishes from now on."""
    found, last, end = [], cell.tracker.newest, cell.clock.monotonic() + LOOK
    while cell.clock.monotonic() < end:
        await cell.clock.sleep(0.005)
        if cell.tracker.newest is not last:
            last = cell.tracker.newest
            found.append({pose.body: pose for pose in last})
    return found


async def connecting(cell: CellSimulation) -> tuple[str, bool]:
    """Error of a connection, and whether the robot itself reports trouble."""
    try:
        await cell.robot.connect()
    except PcmrsError as error:
        return type(error).__name__, bool(cell.robot.trouble)
    return "", bool(cell.robot.trouble)


async def answering(cell: CellSimulation) -> str:
    """Error of a request on the present connection."""
    try:
        await cell.robot.joints()
    except PcmrsError as error:
        return error.text
    return ""


async def starting(cell: CellSimulation) -> str:
    """Reason for which the robot starts no motion."""
    await connected(cell)
    try:
        session = await cell.robot.begin_servo()
    except DeviceError as error:
        return str(error.fields.get("reason", error.text))
    await cell.robot.end_servo(session.session)
    return ""


async def _one_set_point(cell: CellSimulation) -> int:
    """Sends one set point in a session, and returns how many the robot has dropped then."""
    await connected(cell)
    session = (await cell.robot.begin_servo()).session
    here = cell.world.arm.positions.tolist()
    still = [0.0] * len(here)
    now = cell.clock.monotonic()
    before = cell.robot.dropped
    cell.robot.set_point(JointSetpoint(session=session, number=1, sent=now, positions=here, velocities=still))
    dropped = cell.robot.dropped - before
    await cell.robot.end_servo(session)
    return dropped


async def dropped_at_once(cell: CellSimulation) -> int:
    return await _one_set_point(cell)


async def dropped_when_connected_again(cell: CellSimulation) -> int:
    await _one_set_point(cell)
    before = cell.robot.dropped
    await connected(cell)
    return cell.robot.dropped - before


async def stopped(cell: CellSimulation) -> str | None:
    return cell.world.arm.stopped


async def positions(cell: CellSimulation) -> Any:
    return np.array(cell.world.arm.positions)


async def flange_force(cell: CellSimulation) -> float:
    return math.hypot(*cell.world.arm.sensor.flange_force)


async def framing(cell: CellSimulation) -> str:
    """What the virtual cabinet does with its replies; its segments are tested with it."""
    return cell.robot_faults.framing


async def restarts(cell: CellSimulation) -> int:
    """How often the virtual cabinet's application was restarted; its connections are tested with it."""
    return cell.robot_faults.restarts


async def places(cell: CellSimulation) -> tuple[Any, Any]:
    """Reference and head in the tracker frame, m."""
    world = cell.world
    return np.array(world.tracker_from_body_ref().translation), np.array(world.tracker_from_image.translation)


async def response(cell: CellSimulation) -> float:
    """Amplitude of the muscle's response to a full pulse over its hot-spot, V."""
    muscle: Any = cell.world.muscle
    return float(muscle.stimulate(1, cell.world.time, muscle.subject.image_from_hotspot, 100.0).amplitude)


async def tension(cell: CellSimulation) -> float:
    """Electromyogram of 0.1 s from now on, rms, V."""
    await cell.clock.sleep(0.2)
    rate = cell.world.muscle.settings.rate_hz
    samples = cell.world.muscle.samples(round((cell.world.time - 0.1) * rate), round(0.1 * rate))
    return float(np.sqrt(np.mean(np.square(samples))))


def of_frames(shows: Callable[[BodyPose], bool]) -> Sign:
    """Sign that every frame of the coil has, and none without the fault."""
    return Sign(
        frames,
        lambda before, during: (
            bool(during)
            and all(shows(frame["coil"]) for frame in during)
            and not any(shows(frame["coil"]) for frame in before)
        ),
    )


def of_neighbours(shows: Callable[[BodyPose, BodyPose], bool]) -> Sign:
    """Sign that two frames of the coil in a row have, and none without the fault."""

    def found(seen: Frames) -> bool:
        return any(shows(first["coil"], second["coil"]) for first, second in pairwise(seen))

    return Sign(frames, lambda before, during: found(during) and not found(before))


def apart(first: Any, second: Any) -> float:
    """Distance, mm."""
    return float(np.linalg.norm(np.subtract(first, second))) * 1e3


def _moved(before: tuple[Any, Any], during: tuple[Any, Any]) -> tuple[float, float]:
    """How far reference and head have moved, mm."""
    return apart(before[0], during[0]), apart(before[1], during[1])


def _near(value: float, wanted: float) -> bool:
    return abs(value - wanted) < 1.0


def _position(seen: Frames, body: str) -> Any:
    return np.mean([frame[body].position for frame in seen], axis=0)


def _new_refusal(reason: str) -> Sign:
    return Sign(starting, lambda before, during: (before, during) == ("", reason))


NO_FRAMES = Sign(frames, lambda before, during: len(before) > 20 and not during)

SIGNS: Mapping[str, Sign] = {
    "occlude": of_frames(lambda pose: pose.reason == "occluded"),
    "frame_frozen": Sign(
        frames,
        lambda before, during: (
            len(during) > 20
            and len({frame["coil"].frame_number for frame in during}) == 1
            and len({frame["coil"].frame_number for frame in before}) == len(before)
        ),
    ),
    "pose_nan": of_frames(lambda pose: not np.isfinite(pose.position).all()),
    "pose_not_unit": of_frames(lambda pose: abs(math.hypot(*pose.quat_wxyz) - 1.0) > 0.1),
    "pose_jump": Sign(
        frames, lambda before, during: _near(apart(_position(before, "coil"), _position(during, "coil")), 60.0)
    ),
    "not_measured": of_frames(lambda pose: not pose.valid and pose.reason == "out_of_volume"),
    "bad_fit": of_frames(lambda pose: pose.error > 2e-3),
    "phantom_marker": of_neighbours(lambda first, second: apart(first.position, second.position) > 10.0),
    "tool_swap": Sign(
        frames,
        lambda before, during: (
            _near(apart(_position(before, "coil"), _position(during, "body_ref")), 0.0)
            and _near(apart(_position(before, "body_ref"), _position(during, "coil")), 0.0)
        ),
    ),
    "wrong_tool": of_frames(lambda pose: not pose.valid and pose.reason == "wrong_tool"),
    "tracker_rate": Sign(frames, lambda before, during: len(before) > 20 and 0 < len(during) < 5),
    "stamp_reversed": of_neighbours(lambda first, second: second.captured < first.captured),
    "stamp_future": of_frames(lambda pose: pose.captured > pose.sent + 1.0),
    "tracker_unplugged": NO_FRAMES,
    "tracker_absent": NO_FRAMES,
    "bump_reference": Sign(places, lambda before, during: all(map(_near, _moved(before, during), (4.0, 0.0)))),
    "shift_body": Sign(places, lambda before, during: all(map(_near, _moved(before, during), (50.0, 50.0)))),
    "dash_head": Sign(places, lambda before, during: min(_moved(before, during)) > 10.0),
    "no_mep": Sign(response, lambda before, during: before > 0.0 and during == 0.0),
    "preactivation": Sign(tension, lambda before, during: during > before + 15e-6),
    "cut_robot": Sign(connecting, lambda _, during: during == ("UnknownOutcomeError", True)),
    "silence_robot": Sign(connecting, lambda _, during: during == ("UnknownOutcomeError", False)),
    "interrupt": Sign(stopped, lambda _, during: during == "interrupted", in_servo),
    "frame_replies": Sign(framing, lambda before, during: (before, during) == ("whole", "split")),
    "e_stop": _new_refusal("e_stop"),
    "offset_joint": Sign(positions, lambda before, during: abs(during[2] - before[2] - 0.05) < 1e-3),
    "change_mode": _new_refusal("mode_change"),
    "close_brakes": _new_refusal("brakes_closed"),
    "guide_by_hand": Sign(positions, lambda before, during: abs(during[0] - before[0] - 0.01) < 1e-3),
    "refuse_robot": Sign(connecting, lambda _, during: during == ("DeviceRefusedError", False)),
    "drop_client": Sign(answering, lambda before, during: not before and "not connected" in during),
    "restart_cabinet": Sign(restarts, lambda before, during: during == before + 1),
    "late_set_point": Sign(dropped_when_connected_again, lambda before, during: (before, during) == (0, 1)),
    "double_commands": Sign(dropped_at_once, lambda before, during: (before, during) == (0, 1)),
    "withdraw_servo": _new_refusal("no_servo_option"),
    "push_tool": Sign(flange_force, lambda before, during: during > before + 10.0),
}
"""Sign of each fault, when its first line of `test_faults_catalogue.LINES` has brought it about."""
