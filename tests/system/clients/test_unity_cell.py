"""The C# client against a daemon: what it hears is what the bus says, mirrored, and what it asks for is done, once."""

from __future__ import annotations

import asyncio
import json
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from pcmrs.client import Client
from pcmrs.gateway.signing import new_key
from pcmrs.kinematics.model import ArmModel
from pcmrs.kinematics.urdf_arms import find_arm
from pcmrs.messages import BodyPose, JointState, PoseMessage, Target
from pcmrs.spatial import Transform
from pcmrs.testing.arm import stands
from pcmrs.testing.cell import LIGHT, RunningCell, open_cell
from pcmrs.testing.daemon import free_port
from pcmrs.testing.driving import MOVES, plan, until, wait_until_stationary
from pcmrs.testing.impairment import NetworkImpairment
from pcmrs.testing.proxy import udp_proxy
from pcmrs.workflows.settings import SIMULATED_TOOL_MARKER_FROM_TOOL_TIP
from tests.system.clients.unity_programs import (
    NEEDS_MONO,
    SWAP,
    CellProbe,
    cell_probe,
    from_numbers,
    is_answer,
    mirrored,
    mirrored_numbers,
    running_probe,
)

pytest.importorskip("mujoco")

pytestmark = [NEEDS_MONO, pytest.mark.timeout(300)]

LANDMARKS = [number for landmark in plan().landmarks for number in SWAP @ landmark.position]
"""As an object in a Unity scene would have them."""
TARGET = Transform.from_quat_xyzw(plan().poses[0].position, plan().poses[0].quat_xyzw)

WIRE = (1e-6, 1e-4)
"""Rounding of a stream: m, rad."""
MEASURED = (3e-4, 5e-3)
"""Noise of the tracker between two frames, with the head's breathing in between."""
NUDGED = (1e-3, 5e-3)
"""A nudge goes where the planned tool should be, not where it was measured."""

ONCE = dict.fromkeys(
    [
        "registration.plan_landmarks",
        "digitization.digitize_all",
        "registration.register",
        "toolplan.plan",
        "robot.connect",
        "placement.approach",
    ],
    1,
)


@dataclass
class Bus:
    """What the daemon's bus said last."""

    target: Target = field(default_factory=Target)
    bodies: dict[str, Transform] = field(default_factory=dict)
    joints: list[float] = field(default_factory=list)
    moves: asyncio.Event = field(default_factory=asyncio.Event)

    def listen(self, client: Client) -> None:
        client.listen("state/target", Target, lambda message: setattr(self, "target", message))
        client.listen("state/pose/*", BodyPose, self._take_body)
        client.listen("state/joints", JointState, self._take_joints)

    @property
    def image_from_tracker(self) -> Transform:
        return (self.bodies["body_ref"] @ _transform(self.target.body_ref_from_image)).inverse()

    @property
    def tracker_from_tool_tip(self) -> Transform:
        return self.bodies["coil"] @ SIMULATED_TOOL_MARKER_FROM_TOOL_TIP.transform()

    @property
    def image_from_tool_tip(self) -> Transform:
        return self.image_from_tracker @ self.tracker_from_tool_tip

    def _take_body(self, pose: BodyPose) -> None:
        if pose.valid:
            self.bodies[pose.body] = Transform.from_quat_wxyz(pose.position, pose.quat_wxyz)

    def _take_joints(self, joints: JointState) -> None:
        self.joints = joints.positions
        if np.abs(joints.velocities).max() > MOVES:
            self.moves.set()


def _transform(message: PoseMessage | None) -> Transform:
    assert message is not None
    return Transform.from_quat_wxyz(message.position, message.quat_wxyz)


def is_near(numbers: Any, expected: Transform, limits: tuple[float, float]) -> bool:
    """Whether the client's pose is the mirror of the one expected."""
    error = mirrored(expected).inverse() @ from_numbers(numbers)
    return bool(np.linalg.norm(error.translation) < limits[0] and _angle(error) < limits[1])


def _angle(pose: Transform) -> float:
    return float(Rotation.from_matrix(pose.rotation).magnitude())


async def told(
    probe: CellProbe, question: str, expected: Callable[[], Transform], limits: tuple[float, float] = MEASURED
) -> None:
    """Asks until the client tells what the bus says: both go on, and neither waits for the other."""
    numbers = None
    try:
        async with asyncio.timeout(5.0):
            while numbers is None or not is_near(numbers, expected(), limits):
                numbers = (await probe.ask(question))["numbers"]
                await asyncio.sleep(0.01)
    except TimeoutError:
        pytest.fail(f"{question} tells {numbers}, the bus {mirrored(expected())}")


async def test_a_procedure_is_run_and_seen_by_the_client(programs: Path, tmp_path: Path) -> None:
    streams = {link: free_port() for link in ("mixed_reality", "visualization")}
    key = tmp_path / "unity.key"
    new_key(key)
    overrides = (
        *LIGHT,
        *(f"gateway.{link}.stream_port={port}" for link, port in streams.items()),
        "gateway.openigtlink.enabled=true",
        "gateway.openigtlink.port=0",
        f"gateway.peers.unity.key_file={key}",
        "gateway.peers.unity.role=operator",
        "gateway.peers.unity.counter=unix_ns",
        'gateway.peers.unity.allow=["plan", "digitize", "register", "robot", "motion"]',
    )
    async with open_cell(tmp_path / "cell1", ("sim.seed=1", *overrides)) as cell:
        bus = Bus()
        bus.listen(cell.client)
        await over_a_bad_line_every_signed_command_runs_once(programs, cell, key)
        commands, state = cell.ready.links["planner"][1], cell.ready.links["openigtlink"][1]
        await a_scene_shows_the_target(programs, commands, streams["mixed_reality"], state)
        async with cell_probe(programs, commands) as probe:
            await probe.demand(f"receive {streams['mixed_reality']}")
            await probe.demand(f"hear_state {state}")
            await probe.demand("keep_streams")
            await the_state_is_told(cell, probe)
            await the_plan_is_met(probe)
            await all_poses_are_told(bus, probe)
            await the_visualization_is_told(programs, bus, streams["visualization"])
            await the_tool_is_nudged(bus, probe)
            await a_stop_is_obeyed(cell, bus, probe)
            await the_state_is_told(cell, probe)
            await what_is_revoked_is_forgotten(cell, probe)


async def over_a_bad_line_every_signed_command_runs_once(programs: Path, cell: RunningCell, key: Path) -> None:
    """The whole way to the standoff of the planned pose."""
    weather = NetworkImpairment(seed=3, loss=0.15, doubled=0.25, jitter=0.02)
    async with (
        udp_proxy(cell.ready.links["planner"], weather) as (_, port),
        cell_probe(programs, port, "unity", str(key)) as probe,
    ):
        refused = await probe.ask("approach")
        assert refused["error"] == "CommandRefusedException"
        await probe.demand("plan_landmarks", *LANDMARKS)
        await probe.demand("digitize_all")
        (residual_mm,) = await probe.demand("register")
        assert residual_mm > 0.0
        await probe.demand("plan_pose", *mirrored_numbers(TARGET))
        await probe.demand("connect")
        await until(cell.client, lambda snapshot: not snapshot.running)  # connecting has the tool located
        await probe.demand("approach")
        assert min(weather.counted["lost"], weather.counted["doubled"]) > 0
        assert Counter(_ran(cell)) == ONCE
        weather.towards = False
        assert (await probe.ask("raw start_visualizex 0.7"))["error"] == "UnknownOutcomeException"


def _ran(cell: RunningCell) -> list[str]:
    """The operations of the signed client that the journal has as accepted."""
    ended = [row for row in cell.rows() if row.kind == "outcome" and row.source == "peer:unity"]
    return [f"{row.branch}.{row.operation}" for row in ended if row.verdict and row.verdict.decision == "accepted"]


async def the_state_is_told(cell: RunningCell, probe: CellProbe) -> None:
    await probe.known("state")
    snapshot = await cell.client.state()
    async with asyncio.timeout(5.0):
        while (told := await probe.ask("state"))["sequence"] != snapshot.sequence:
            snapshot = await cell.client.state()
    assert told["branches"] == snapshot.branches
    assert (told["latched"], told["plan"], told["registration"]) == (
        snapshot.latched, snapshot.plan, snapshot.registration,
    )  # fmt: skip
    assert told["flags"] == snapshot.flags


async def the_plan_is_met(probe: CellProbe) -> None:
    placed = await probe.demand("confirm")
    assert is_near(placed[:7], TARGET, (1e-3, 5e-3))
    assert 0.0 <= placed[7] < 1.0
    assert 0.0 <= placed[8] < 1.0


async def all_poses_are_told(bus: Bus, probe: CellProbe) -> None:
    await told(probe, "pose Target", lambda: TARGET, WIRE)
    await told(probe, "pose Target", lambda: _transform(bus.target.pose), WIRE)
    await told(probe, "pose Registration", lambda: _transform(bus.target.body_ref_from_image), WIRE)
    await told(probe, "pose Tool", lambda: bus.image_from_tool_tip)
    await told(probe, "tracked CoilToTracker", lambda: bus.tracker_from_tool_tip)
    await told(probe, "tracked ReferenceToTracker", lambda: bus.bodies["body_ref"])
    await told(probe, "tracked CoilToImage", lambda: bus.image_from_tool_tip)
    await told(probe, "tracked TargetToImage", lambda: TARGET, WIRE)
    arm = ArmModel(find_arm("iiwa14"))
    await told(probe, "tracked FlangeToBase", lambda: arm.forward(bus.joints))
    await told(probe, "flange", lambda: arm.forward(bus.joints))
    np.testing.assert_allclose(await probe.demand("joints"), bus.joints, atol=1e-3)


async def the_tool_is_nudged(bus: Bus, probe: CellProbe) -> None:
    """It moves along its own axes, and turns about them, as somebody in the scene meant."""
    along = Transform.from_rotvec((0.002, -0.001, 0.003), (0.0, 0.0, 0.0))
    about = Transform.from_rotvec((0.0, 0.0, 0.0), (0.01, -0.02, 0.03))
    before = bus.image_from_tool_tip
    await probe.demand("move", *mirrored_numbers(along)[:3])
    await told(probe, "pose Tool", lambda: before @ along, NUDGED)
    await probe.demand("turn", *mirrored_numbers(about)[3:])
    await told(probe, "pose Tool", lambda: before @ along @ about, NUDGED)


async def the_visualization_is_told(programs: Path, bus: Bus, port: int) -> None:
    """Its stream is right-handed and in mm."""
    with running_probe(programs) as probe:
        probe.ask(f"receive {port}")
        async with asyncio.timeout(5.0):
            numbers = None
            while numbers is None or not is_near(numbers, bus.image_from_tool_tip, MEASURED):
                await asyncio.sleep(0.02)
                numbers = probe.ask("newest VisualizedTool")["numbers"]


async def a_scene_shows_the_target(programs: Path, *ports: int) -> None:
    """The components, run on the stub, put their objects where target and tool are, which is at the standoff."""
    words = ["mono", str(programs / "Scene.exe"), *map(str, ports), "50"]
    process = await asyncio.create_subprocess_exec(*words, stdout=asyncio.subprocess.PIPE)
    async with asyncio.timeout(20.0):
        lines = (await process.communicate())[0].decode().splitlines()
    frames = [json.loads(line) for line in lines if is_answer(line)]
    assert process.returncode == 0
    assert len(frames) == 50
    assert is_near(frames[-1]["target"], TARGET, WIRE)
    seen = from_numbers(frames[-1]["tool"])
    away = mirrored(TARGET).inverse() @ seen.translation
    assert 0.01 < np.linalg.norm(away) < 0.1
    assert away[1] / np.linalg.norm(away) > 0.99, (
        "the tool's axis, z on the wire and y in Unity, points away from the body"
    )
    assert frames[-1]["registration"] == "111"


async def what_is_revoked_is_forgotten(cell: RunningCell, probe: CellProbe) -> None:
    await wait_until_stationary(cell.client)
    await probe.demand("home")
    await probe.known("pose Target")
    await probe.demand("reinitiate")
    await probe.forgotten("pose Tool", 2.0)
    await probe.forgotten("pose Target", 8.0)
    await probe.forgotten("pose Registration", 8.0)


async def a_stop_is_obeyed(cell: RunningCell, bus: Bus, probe: CellProbe) -> None:
    bus.moves.clear()
    await probe.demand("begin_home")
    async with asyncio.timeout(10.0):
        await bus.moves.wait()
    await probe.demand("stop")
    ended = await probe.ask("end")
    assert (ended["error"], ended["reason"]) == ("CommandRefusedException", "stopped")
    await stands(cell)
    assert (await cell.client.state()).latched
