"""The simulated cell: all devices in one process, stepped in the time of a clock."""

from __future__ import annotations

import math
from collections.abc import AsyncIterator, Callable, Collection, Iterator, Mapping
from contextlib import asynccontextmanager, contextmanager
from functools import partial
from typing import Any

import msgspec
import structlog

from pcmrs.background import background_task
from pcmrs.clock import Clock
from pcmrs.devices.motion.force import ForceSettings
from pcmrs.devices.protocols import Device
from pcmrs.devices.tables import read_table
from pcmrs.errors import ConfigurationError
from pcmrs.kinematics.arms import ArmFacts
from pcmrs.kinematics.urdf_arms import find_arm
from pcmrs_sim.emg import SimEmg
from pcmrs_sim.faults import inject
from pcmrs_sim.plant import STEP
from pcmrs_sim.pointer import SimPointer
from pcmrs_sim.robot import SimRobot
from pcmrs_sim.robot_faults import RobotFaults
from pcmrs_sim.scene import SimScene
from pcmrs_sim.settings import SimSettings, read_settings
from pcmrs_sim.stimulator import SimStimulator
from pcmrs_sim.tracker import SimTracker
from pcmrs_sim.world import World

BATCH = 0.010
"""Period of the stepping task, s of the clock."""
REST_DETECTION_TIME = 0.050
"""Time within which the rest of an arm without dynamics is detected, s of the clock."""
ROUNDING = 1e-6
"""Tolerance of a number of steps. Sums of steps are not exact, and a surplus step would cost an update of all
devices."""
LONGEST_CATCH_UP = 0.1
"""Longest time that one wake-up simulates, s. Time beyond it is lost: the cell's motions take longer."""

log = structlog.get_logger(__name__)


class CellSimulation:
    """One world and its devices.

    Args:
        settings: Errors and geometry.
        facts: Nominal geometry and limits of the arm.
        force: Limit of the force on the tool, and the relief from it.
        clock: Clock that the simulation follows, as fast as the processor can.

    Attributes:
        devices: The devices by name: robot, tracker, pointer, scene, stimulator and emg.
        robot: The robot.
        tracker: The tracker.
        stimulator: The stimulator.
        receive_calls: Called before each stride of physics, so that calls that have arrived are processed first.
        facts: Nominal geometry and limits of the arm.
        clock: Clock that the simulation follows.
        world: True state of the cell.
        lag: Total time that was lost because the simulation was slower than the clock, s.
    """

    def __init__(self, settings: SimSettings, facts: ArmFacts, force: ForceSettings, clock: Clock) -> None:
        self.facts = facts
        self.clock = clock
        start = clock.monotonic()
        self.world = World(settings, facts, force, start)
        self.robot = SimRobot(self.world, clock, start)
        self.tracker = SimTracker(self.world, clock, start)
        self.stimulator = SimStimulator(self.world, clock)
        self.receive_calls: Callable[[], None] = lambda: None
        self._watchers: list[Callable[[], None]] = []
        pointer = SimPointer(self.world, clock)
        self.devices: Mapping[str, Device] = {
            "robot": self.robot,
            "tracker": self.tracker,
            "pointer": pointer,
            "scene": SimScene(self.world, pointer, partial(inject, self), self.watched),
            "stimulator": self.stimulator,
            "emg": SimEmg(self.world, clock),
        }
        self._kinematic = settings.arm.physics == "kinematic"
        # An arm without dynamics catches up with any delay at once, so that no time is lost.
        self._longest_catch_up = math.inf if self._kinematic else LONGEST_CATCH_UP
        self.lag = 0.0

    async def run(self) -> None:
        """Step the world until cancelled, then close all devices."""
        try:
            while True:
                await self.clock.sleep(self._pause())
                self.catch_up()
        finally:
            self.robot.close()
            self.tracker.close()
            self.stimulator.close()
            if self.lag:
                log.warning("the simulated cell was slower than its clock", lag=round(self.lag, 3))

    def _pause(self) -> float:
        """Return the time until the world must be stepped again, s. Without dynamics, that is when a device is due."""
        if not self._kinematic:
            return BATCH
        # One more step, because simulated time passes in whole steps.
        pause = max(0.0, min(self.robot.due, self.tracker.due) - self.clock.monotonic()) + STEP
        return pause if self.world.arm.at_rest else min(pause, REST_DETECTION_TIME)

    @property
    def robot_faults(self) -> RobotFaults:
        """Present faults of the robot."""
        return self.robot.faults

    def cut_robot(self, cut: bool) -> None:
        """Cut the robot's link, or restore it."""
        self.robot.cut(cut)

    def is_active(self, served: Collection[str]) -> bool:
        """Return true if one of these devices is active: the arm follows a reference, or the stimulator can fire."""
        return ("robot" in served and self.robot.follows) or ("stimulator" in served and self.stimulator.can_fire)

    def lose_node(self, served: Collection[str], reason: str) -> None:
        """Make devices safe, because their node cannot stop them any more: brake the arm, disarm the stimulator.

        Args:
            served: Names of the devices of the lost node.
            reason: Clause that says why the node is considered lost.
        """
        if "robot" in served:
            self.robot.lose_node(reason)
        if "stimulator" in served:
            self.stimulator.lose_node(reason)

    @contextmanager
    def watched(self, watcher: Callable[[], None]) -> Iterator[None]:
        """Return a context in which `watcher` is called each time after time has passed."""
        self._watchers.append(watcher)
        try:
            yield
        finally:
            self._watchers.remove(watcher)

    def catch_up(self) -> None:
        """Simulate up to the present, so that an answer between two wake-ups holds the present state."""
        self.advance(self.clock.monotonic())

    def advance(self, now: float) -> None:
        """Simulate up to a time, s of the clock."""
        world = self.world
        # A machine that is too slow would fall behind more and more, so that time beyond the limit is skipped.
        lost = max(0.0, now - world.time - self._longest_catch_up)
        self.lag += lost
        world.time += lost
        while world.time + STEP <= now:
            self.receive_calls()
            # A stride ends when a device is due, so that the device measures the state of that time.
            due = min(self.robot.due, self.tracker.due, now)
            world.step(max(1, math.ceil((due - world.time) / STEP - ROUNDING)))
            self.robot.update(world.time)
            self.tracker.update(world.time)
        self.stimulator.update(now)
        for watcher in tuple(self._watchers):  # a copy, because a watcher may end its own context
            watcher()


@asynccontextmanager
async def running_cell(settings: Mapping[str, Any], clock: Clock) -> AsyncIterator[CellSimulation]:
    """Run a cell in the time of a clock until the context ends.

    Args:
        settings: The whole configuration; ``sim`` and ``robot`` are read.
        clock: The cell's clock.

    Raises:
        ConfigurationError: The arm is unknown, or the table ``sim`` is wrong.
    """
    sim_settings = read_settings(settings)
    cell = CellSimulation(sim_settings, _arm(settings, sim_settings), _force_settings(settings), clock)
    async with background_task(cell.run(), "simulated cell"):
        yield cell


def _force_settings(settings: Mapping[str, Any]) -> ForceSettings:
    """Return the arm's force limit: infinite if the driver of a real arm guards the force."""
    force = read_table(settings, "robot", ForceSettings)
    # Set points come at their usual rate by the machine's clock, so the deadman is scaled to the cell's faster clock.
    force = msgspec.structs.replace(force, deadman=force.deadman * settings.get("cell", {}).get("rate", 1.0))
    if settings.get("robot", {}).get("driver", "sim") == "sim":
        return force
    return ForceSettings(force_limit=math.inf)


def _arm(settings: Mapping[str, Any], sim_settings: SimSettings) -> ArmFacts:
    facts = find_arm(settings.get("robot", {}).get("model", "iiwa14"))
    for name, values in (("home", sim_settings.arm.home), ("stiffness", sim_settings.arm.stiffness)):
        if len(values) not in (0, len(facts.joints)):
            text = f"sim.arm.{name} holds {len(values)} numbers; {facts.name} has {len(facts.joints)} joints."
            raise ConfigurationError(text, name=name, values=list(values))
    return facts
