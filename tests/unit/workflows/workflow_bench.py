"""The real procedure on the simulated devices in one process, on a loop whose time jumps when everybody waits."""

from __future__ import annotations

import asyncio
import itertools
import json
from collections.abc import AsyncIterator, Awaitable, Callable, Mapping
from contextlib import asynccontextmanager
from typing import Any, cast

import msgspec
import numpy as np

from pcmrs.background import background_task
from pcmrs.config import merge_tables
from pcmrs.devices.poses import PoseFeed
from pcmrs.devices.protocols import LatchingRobot, LatchingStimulator, RobotDriver, Scene, TrackerDriver
from pcmrs.dispatcher import Dispatcher, DispatcherListener, Recorder, Run, Workflow
from pcmrs.dispatcher.execution import MotionChecker
from pcmrs.kinematics.arms import ARMS
from pcmrs.kinematics.model import ArmModel
from pcmrs.messages import Command, DeviceEvent, Snapshot, Verdict
from pcmrs.simulated_time.clock import SimulatedClock
from pcmrs.spatial import Transform
from pcmrs.workflows.cell import Cell
from pcmrs.workflows.data import PlacementData, as_transform
from pcmrs.workflows.settings import ProcedureSettings
from pcmrs.workflows.surface import read_surface
from pcmrs_sim.opening import open_devices
from tests import ROOT
from tests.support.shipped import shipped_workflow

PLAN: dict[str, Any] = json.loads((ROOT / "examples" / "ratms_plan.json").read_text())
LANDMARKS = PLAN["landmarks"]
POSES = PLAN["poses"]
DEVICES = ("robot", "tracker", "pointer", "scene", "stimulator", "emg")
AT_REST = 1e-3
"""Joint velocity below which the simulated arm counts as standing, rad/s."""

QUICK_SIM: dict[str, Any] = {
    "arm": {"physics": "kinematic", "state_rate_hz": 50.0},
    "tracker": {"rate_hz": 30.0},
    "digitization": {"reach_time": 0.05, "rest_time": 0.05},
}
DYNAMICS: dict[str, Any] = {"arm": {"physics": "mujoco"}}
"""For what friction, masses, controller or the noise of the force sensor decide."""
QUICK_PROCEDURE: dict[str, Any] = {
    "registration": {"samples": 2},
    "motion": {
        "joint_speed_fraction": 1.0,
        "joint_acceleration": 5.0,
        "linear_velocity": 0.5,
        "near_velocity": 0.25,
    },
    "placement": {"frames": 2, "settle_time": 0.1, "tolerance_mm": 0.5, "tolerance_deg": 0.2},
    "following": {"period": 0.016},
}


class ListRecorder:
    """A journal in memory that takes only what a journal could keep.

    Attributes:
        rows: Kind and name of the operation or event, in order.
        verdicts: As they were decided.
    """

    def __init__(self) -> None:
        self.rows: list[tuple[str, str]] = []
        self.verdicts: list[Verdict] = []

    async def intent(self, command: Command, states: Mapping[str, str]) -> None:
        self.rows.append(("intent", command.operation))

    async def decision(
        self,
        command: Command,
        verdict: Verdict,
        states: Mapping[str, str],
        changes: Mapping[str, Any],
        *,
        with_intent: bool,
    ) -> None:
        msgspec.json.encode([verdict, dict(changes)])
        self.rows.append(("outcome", command.operation))
        self.verdicts.append(verdict)

    async def event(self, event: DeviceEvent, states: Mapping[str, str]) -> None:
        self.rows.append(("event", event.code))

    def recall(self, source: str, command_id: str) -> None:
        """Nothing was decided before."""


class Latched:
    """A device without a node: nothing is between it and the cell that could be late, so it needs no latch."""

    latched = False

    def __init__(self, name: str, device: Any, hold: Callable[[], Awaitable[object]]) -> None:
        self.name, self.stop = name, hold
        self._device = device

    def __getattr__(self, method: str) -> Any:
        return getattr(self._device, method)

    async def release_latch(self) -> None:
        """There is none."""


class WorkflowBench(DispatcherListener):
    """A dispatcher with the real workflow, its cell, and the simulation's own hands on the scene.

    Attributes:
        published: Snapshots, verdicts and events in order.
        tracker_session: In which the tracker's frames come.
    """

    def __init__(
        self,
        workflow: Workflow[Cell, PlacementData],
        devices: Mapping[str, Any],
        settings: ProcedureSettings,
        clock: SimulatedClock,
        journal: Recorder | None,
        planner: MotionChecker[Cell, PlacementData] | None,
    ) -> None:
        self.clock = clock
        self.robot: RobotDriver = devices["robot"]
        self.scene: Scene = devices["scene"]
        self.tracker: TrackerDriver = devices["tracker"]
        self.recorder = ListRecorder()
        self.published: list[Snapshot | Verdict | DeviceEvent] = []
        self.tracker_session = "first"
        self.cell = Cell(
            robot=cast(LatchingRobot, Latched("robot", devices["robot"], devices["robot"].hold)),
            pointer=devices["pointer"],
            poses=PoseFeed(clock, settings.max_pose_age),
            arm=ArmModel(ARMS["iiwa14"]),
            clock=clock,
            settings=settings,
            surface=read_surface(settings),
            stimulator=cast(
                LatchingStimulator, Latched("stimulator", devices["stimulator"], devices["stimulator"].disarm)
            ),
            emg=devices["emg"],
        )
        recorder = journal or self.recorder
        self.dispatcher = Dispatcher(workflow, self.cell, clock, recorder, self.cell.make_safe, planner=planner)
        self.dispatcher.add_listener(self)
        self._ids = itertools.count(1)

    def on_publish(self, message: Snapshot | Verdict | DeviceEvent) -> None:
        self.published.append(message)

    @property
    def states(self) -> dict[str, str]:
        return self.dispatcher.snapshot().branches

    @property
    def data(self) -> PlacementData:
        return self.dispatcher.procedure.data

    async def do(self, name: str, **arguments: Any) -> Verdict:
        """Submits a command and waits for its verdict."""
        branch, operation = name.split(".")
        if name in self.dispatcher.snapshot().release:
            await self.until(lambda: not self.dispatcher.snapshot().stop.pending)
            arguments = {"stop": self.dispatcher.stop_number} | arguments
        command = Command(
            id=f"c{next(self._ids)}", branch=branch, operation=operation, source="test:user", arguments=arguments
        )
        return await self.dispatcher.submit(command)

    async def accept(self, name: str, **arguments: Any) -> Verdict:
        """A command that must be accepted."""
        verdict = await self.do(name, **arguments)
        assert verdict.decision == "accepted", f"{name}: {verdict.reason}"
        return verdict

    async def refuse(self, name: str, code: str, decision: str = "rejected", **arguments: Any) -> Verdict:
        """A command that must not be accepted, for the reason `code`; when rejected, nothing has changed."""
        before = self.states, self.data
        verdict = await self.do(name, **arguments)
        assert verdict.reason is not None, f"{name} was accepted"
        assert (verdict.decision, verdict.reason.code) == (decision, code), verdict.reason
        if decision == "rejected":
            assert (self.states, self.data) == before
        return verdict

    def run(self, name: str) -> Run[Any, Any]:
        """Return a run as checks and steps get it: of an operation without arguments, whatever the states allow."""
        branch, operation = name.split(".")
        command = Command(id="run", branch=branch, operation=operation, source="test:user", arguments={})
        return Run(command, None, self.states, self.cell, self.clock, self.data, lambda _: None)

    async def connect(self) -> None:
        """Connects the robot and waits until the arm has been located."""
        await self.accept("robot.connect")
        await self.until(lambda: self.states["placement"] != "unknown" and not self.dispatcher.snapshot().running)

    async def register(self) -> Verdict:
        """To a connected robot, a registered head and the first pose planned."""
        await self.connect()
        await self.accept("registration.plan_landmarks", landmarks=LANDMARKS)
        await self.accept("digitization.digitize_all")
        registered = await self.accept("registration.register")
        await self.accept("toolplan.plan", **POSES[0])
        return registered

    async def to_standoff(self) -> None:
        await self.register()
        await self.accept("placement.approach")

    async def to_placed(self) -> Verdict:
        await self.to_standoff()
        return await self.accept("placement.confirm")

    @asynccontextmanager
    async def moving(
        self, name: str, *, faster_than: float = 0.05, **arguments: Any
    ) -> AsyncIterator[asyncio.Task[Verdict]]:
        """A motion in the middle of which a joint moves faster than `faster_than`, rad/s."""
        task = asyncio.create_task(self.do(name, **arguments))
        await self.until(lambda: task.done() or self.speed() > faster_than)
        assert not task.done(), task.result()
        yield task
        await task

    async def until(self, condition: Callable[[], bool]) -> None:
        """Waits for what needs time to pass."""
        for _ in range(10_000):
            if condition():
                return
            await self.clock.sleep(0.005)
        raise AssertionError("it did not come true in 50 s of the cell")

    def speed(self) -> float:
        """The greatest joint velocity last measured, rad/s."""
        return 0.0 if self.cell.joints is None else float(np.abs(self.cell.joints.velocities).max())

    async def true_height(self) -> float:
        """Where the contact point truly is along its axis above the plan mapped by the registration, m."""
        truth = await self.scene.truth()
        assert self.data.plan is not None
        assert self.data.registered is not None
        image_from_body_ref = as_transform(self.data.registered.body_ref_from_image).inverse()
        image_from_tracker = image_from_body_ref @ as_transform(truth.tracker_from_body_ref).inverse()
        image_from_tool_tip = image_from_tracker @ as_transform(truth.tracker_from_coil)
        plan_from_tool_tip: Transform = as_transform(self.data.plan).inverse() @ image_from_tool_tip
        return float(plan_from_tool_tip.translation[2])

    async def pump(self) -> None:
        """Takes what robot and tracker report, as the daemon does."""
        async with asyncio.TaskGroup() as tasks:
            tasks.create_task(self._take_joints())
            tasks.create_task(self._take_poses())

    async def _take_joints(self) -> None:
        async for state in self.robot.states():
            self.cell.update_joints(state)

    async def _take_poses(self) -> None:
        async for frame in self.tracker.frames():
            for pose in frame:
                self.cell.poses.update(msgspec.structs.replace(pose, session=self.tracker_session))


@asynccontextmanager
async def open_bench(
    procedure: Mapping[str, Any] | None = None,
    sim: Mapping[str, Any] | None = None,
    *,
    workflow: str | Workflow[Cell, PlacementData] = "ratms",
    journal: Recorder | None = None,
    planner: MotionChecker[Cell, PlacementData] | None = None,
) -> AsyncIterator[WorkflowBench]:
    """A bench with an arm without dynamics, quick motions and touches, and what the test sets itself, table by table.

    The workflow's own defaults are in force; `journal` takes the place of the bench's recorder. Without a planner,
    all checks are asked in the loop.
    """
    opened_workflow = shipped_workflow(workflow) if isinstance(workflow, str) else workflow
    defaults = opened_workflow.blueprint.defaults
    quick = merge_tables(defaults, {"procedure": QUICK_PROCEDURE, "sim": QUICK_SIM})
    values = merge_tables(quick, {"procedure": procedure or {}, "sim": sim or {}})
    settings = msgspec.convert(values["procedure"], ProcedureSettings)
    clock = SimulatedClock(asyncio.get_running_loop())
    async with open_devices(DEVICES, {"sim": values["sim"]}, clock) as opened:
        bench = WorkflowBench(opened_workflow, opened, settings, clock, journal, planner)
        async with background_task(bench.pump()):
            await bench.until(lambda: bench.cell.poses.seen("coil") and bench.cell.joints is not None)
            yield bench
            await bench.dispatcher.close()
