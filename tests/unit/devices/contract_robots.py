"""Every robot driver in a cell of its own: the simulated arm itself, and drivers of real arms over virtual cabinets."""

import asyncio
import math
from collections.abc import AsyncIterator, Callable
from contextlib import AbstractAsyncContextManager, AsyncExitStack, asynccontextmanager
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
import pytest

from pcmrs.clock import Clock, SystemClock
from pcmrs.devices.drivers import kst
from pcmrs.devices.motion.force import ForceSettings
from pcmrs.kinematics.arms import ARMS
from pcmrs.messages import DeviceEvent, JointState, JointTrajectory
from pcmrs.simulated_time.clock import SimulatedClock
from pcmrs.simulated_time.loop import SimulatedLoop
from pcmrs.spatial import Floats, Transform

pytest.importorskip("mujoco")

from pcmrs_sim.cell import CellSimulation
from pcmrs_sim.head import surface_point
from pcmrs_sim.kst.server import serve_kst
from pcmrs_sim.settings import ArmSettings, ConfiguredPose, GeometrySettings, SimSettings

FACTS = ARMS["iiwa14"]
HOME = np.array(FACTS.home)
FLANGE_FROM_TOOL = GeometrySettings().flange_from_tool_tip.transform
LOOP_OF_DRIVER: dict[str, Callable[[], asyncio.AbstractEventLoop]] = {
    "sim": SimulatedLoop,
    "kst": asyncio.new_event_loop,
}
"""Driver to the event loop of its cell: simulated time, unless its protocol goes over a socket."""
MOVED = 5e-5
"""A joint that is farther from its home position has been moved, rad."""

Physics = Literal["kinematic", "mujoco"]


def driver_here() -> str:
    """Driver of the running event loop; see `LOOP_OF_DRIVER`."""
    return "sim" if isinstance(asyncio.get_running_loop(), SimulatedLoop) else "kst"


def smooth(start: Floats, goal: Floats, duration: float = 0.5) -> JointTrajectory:
    """Minimum-jerk motion, at rest at both ends."""
    time = np.linspace(0.0, 1.0, 1 + round(duration / 0.005))
    way = 10 * time**3 - 15 * time**4 + 6 * time**5
    return JointTrajectory(period=0.005, positions=(start + way[:, None] * (goal - start)).tolist())


@dataclass
class Bench:
    """A connected robot.

    Attributes:
        robot: Of the driver.
        clock: Of its cell.
        cell: The truth.
        events: What it has reported.
        states: What it has told.
    """

    robot: Any
    clock: Clock
    cell: CellSimulation
    events: list[DeviceEvent] = field(default_factory=list)
    states: list[JointState] = field(default_factory=list)

    async def back_home(self) -> None:
        """Bring an arm that tests share to its home position, connected, and forget what it has reported.

        The test before has ended its faults.
        """
        await self.robot.connect()
        here = np.array((await self.robot.hold()).positions)
        if np.abs(here - HOME).max() > MOVED:
            assert (await self.robot.follow(smooth(here, HOME, 1.0))).outcome == "done"
        self.events.clear()
        self.states.clear()

    async def moving(self) -> None:
        """Returns once the arm is well on its way."""
        async with asyncio.timeout(10.0):
            while not self.states or np.abs(self.states[-1].velocities).max() < 0.02:
                await self.clock.sleep(0.01)

    async def touching(self, force: float) -> None:
        """Returns once the tool presses on the body, with more than `force`, N."""
        async with asyncio.timeout(10.0):
            while self.cell.world.arm.contact.force < force:
                await self.clock.sleep(0.005)

    async def told(self, code: str) -> DeviceEvent:
        """Returns the first event, which must be this one."""
        async with asyncio.timeout(10.0):
            while not self.events:
                await self.clock.sleep(0.01)
        assert self.events[0].code == code
        return self.events[0]


def body_before_tool(gap: float) -> ConfiguredPose:
    """The head with its crown `gap` (m) before the face of the tool, upright on it, as the arm is known."""
    from pcmrs.kinematics.model import ArmModel

    tool = ArmModel(FACTS).forward(HOME) @ FLANGE_FROM_TOOL
    crown = surface_point((0.0, 0.0, 1.0))
    place = tool @ Transform(np.eye(3), np.array([0.0, 0.0, -gap])) @ Transform(np.eye(3), -crown)
    position, quat = place.translation.tolist(), place.quat_wxyz.tolist()
    return ConfiguredPose((position[0], position[1], position[2]), (quat[0], quat[1], quat[2], quat[3]))


def _cell(clock: Clock, gap: float | None, force: ForceSettings, physics: Physics) -> CellSimulation:
    geometry = GeometrySettings(world_from_image=None if gap is None else body_before_tool(gap))
    return CellSimulation(SimSettings(arm=ArmSettings(physics=physics), geometry=geometry), FACTS, force, clock)


@asynccontextmanager
async def _running(cell: CellSimulation) -> AsyncIterator[CellSimulation]:
    stepping = asyncio.create_task(cell.run())
    try:
        yield cell
    finally:
        stepping.cancel()
        await asyncio.wait((stepping,))


@asynccontextmanager
async def sim_bench(gap: float | None, physics: Physics) -> AsyncIterator[Bench]:
    """The built-in simulation, in simulated time."""
    clock = SimulatedClock(asyncio.get_running_loop())
    async with _running(_cell(clock, gap, ForceSettings(), physics)) as cell:
        yield Bench(cell.devices["robot"], clock, cell)


@asynccontextmanager
async def kst_bench(gap: float | None, physics: Physics) -> AsyncIterator[Bench]:
    """The KST driver over the virtual cabinet."""
    clock = SystemClock()
    async with AsyncExitStack() as stack:
        unguarded = ForceSettings(force_limit=math.inf)  # the driver guards the force, as on a real arm
        cell = await stack.enter_async_context(_running(_cell(clock, gap, unguarded, physics)))
        host, port = await stack.enter_async_context(serve_kst(cell, "127.0.0.1", 0))
        settings = {"kst": {"host": host, "port": port, "reply_timeout": 1.0}}
        devices = await stack.enter_async_context(kst.open_devices(("robot",), settings, clock))
        yield Bench(devices["robot"], clock, cell)


BENCHES: dict[str, Callable[[float | None, Physics], AbstractAsyncContextManager[Bench]]] = {
    "sim": sim_bench,
    "kst": kst_bench,
}


async def _collect(stream: AsyncIterator[Any], into: list[Any]) -> None:
    async for each in stream:
        into.append(each)


@asynccontextmanager
async def bench(gap: float | None = None, physics: Physics = "kinematic") -> AsyncIterator[Bench]:
    """A robot of the running loop's driver, and a head `gap` (m) before its tool, or far away."""
    async with BENCHES[driver_here()](gap, physics) as it:
        listening = [
            asyncio.create_task(_collect(it.robot.events(), it.events)),
            asyncio.create_task(_collect(it.robot.states(), it.states)),
        ]
        await asyncio.sleep(0)
        yield it
        for task in listening:
            task.cancel()
