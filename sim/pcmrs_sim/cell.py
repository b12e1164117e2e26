"""The cell: all simulated devices in one process, stepped in the time of the clock."""

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
"""Time between wake-ups of the stepping task, s of the clock."""
LATEST_REST = 0.050
"""That an arm without dynamics has come to rest is seen within this, s of the clock."""
ROUNDING = 1e-6
"""Part of a step: sums of steps are not exact, and one more step for that would be one more look at everything."""
LONGEST_CATCH_UP = 0.1
"""Time that one wake-up simulates at most, s; what is beyond is lost, and the cell's motions take longer."""

log = structlog.get_logger(__name__)


class CellSimulation:
    """One world and its devices.

    Args:
        settings: Errors and geometry.
        facts: The arm.
        force: When the force on the tool is too great.
        clock: The cell keeps up with it as far as the processor can.

    Attributes:
        devices: Robot, tracker, pointer, scene, stimulator and emg by those names.
        robot: One of them.
        tracker: Another one.
        stimulator: Another one.
        listen: Called before each stride of physics: what has been asked meanwhile is done first.
        facts: The arm.
        clock: The cell keeps up with it.
        world: The truth.
        lag: Time by which the simulation fell behind the clock in all, s.
    """

    def __init__(self, settings: SimSettings, facts: ArmFacts, force: ForceSettings, clock: Clock) -> None:
        self.facts = facts
        self.clock = clock
        start = clock.monotonic()
        self.world = World(settings, facts, force, start)
        self.robot = SimRobot(self.world, clock, start)
        self.tracker = SimTracker(self.world, clock, start)
        self.stimulator = SimStimulator(self.world, clock)
        self.listen: Callable[[], None] = lambda: None
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
        self._longest = math.inf if self._kinematic else LONGEST_CATCH_UP
        self.lag = 0.0

    async def run(self) -> None:
        """Steps until cancelled; then no device publishes or answers any more."""
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
        """Until it has to be stepped again, s: what costs nothing to step waits for what is due next."""
        if not self._kinematic:
            return BATCH
        # One step more, for time goes on in whole steps.
        pause = max(0.0, min(self.robot.due, self.tracker.due) - self.clock.monotonic()) + STEP
        return pause if self.world.arm.at_rest else min(pause, LATEST_REST)

    @property
    def robot_faults(self) -> RobotFaults:
        """What is wrong with the robot."""
        return self.robot.faults

    def cut_robot(self, cut: bool) -> None:
        """Cuts the robot's link, or restores it."""
        self.robot.cut(cut)

    def acts(self, served: Collection[str]) -> bool:
        """Whether one of these devices acts: the arm follows something, or the stimulator can fire."""
        return ("robot" in served and self.robot.follows) or ("stimulator" in served and self.stimulator.acts)

    def lose_node(self, served: Collection[str], why: str) -> None:
        """Nobody can stop these devices any more: the arm brakes, and the stimulator disarms.

        Args:
            served: By the node that is gone or silent.
            why: Why it is taken for that, as half a sentence.
        """
        if "robot" in served:
            self.robot.lose_node(why)
        if "stimulator" in served:
            self.stimulator.lose_node(why)

    @contextmanager
    def watched(self, watcher: Callable[[], None]) -> Iterator[None]:
        """Calls `watcher` whenever time has passed, as long as the context lasts."""
        self._watchers.append(watcher)
        try:
            yield
        finally:
            self._watchers.remove(watcher)

    def catch_up(self) -> None:
        """Simulates up to the clock's present: who asks between two wake-ups of the cell is told how things are now."""
        self.advance(self.clock.monotonic())

    def advance(self, now: float) -> None:
        """Simulates up to `now`, s of the clock."""
        world = self.world
        lost = max(0.0, now - world.time - self._longest)
        self.lag += lost
        world.time += lost
        while world.time + STEP <= now:
            self.listen()
            due = min(self.robot.due, self.tracker.due, now)
            world.step(max(1, math.ceil((due - world.time) / STEP - ROUNDING)))
            self.robot.update(world.time)
            self.tracker.update(world.time)
        self.stimulator.update(now)
        for watcher in tuple(self._watchers):
            watcher()


@asynccontextmanager
async def running_cell(settings: Mapping[str, Any], clock: Clock) -> AsyncIterator[CellSimulation]:
    """A cell whose time passes with the clock, until the context ends.

    Args:
        settings: The whole configuration; ``sim`` and ``robot`` are read.
        clock: The cell's clock.

    Raises:
        ConfigurationError: The arm is unknown, or the table ``sim`` is wrong.
    """
    own = read_settings(settings)
    cell = CellSimulation(own, _arm(settings, own), _force_settings(settings), clock)
    async with background_task(cell.run(), "simulated cell"):
        yield cell


def _force_settings(settings: Mapping[str, Any]) -> ForceSettings:
    """When the arm itself yields to a force: never, behind a driver that guards the force as on a real arm."""
    force = read_table(settings, "robot", ForceSettings)
    # In a cell that is faster than real time set points come as often as ever, by the machine's clock.
    force = msgspec.structs.replace(force, deadman=force.deadman * settings.get("cell", {}).get("rate", 1.0))
    if settings.get("robot", {}).get("driver", "sim") == "sim":
        return force
    return ForceSettings(force_limit=math.inf)


def _arm(settings: Mapping[str, Any], own: SimSettings) -> ArmFacts:
    facts = find_arm(settings.get("robot", {}).get("model", "iiwa14"))
    for name, values in (("home", own.arm.home), ("stiffness", own.arm.stiffness)):
        if len(values) not in (0, len(facts.joints)):
            text = f"sim.arm.{name} holds {len(values)} numbers; {facts.name} has {len(facts.joints)} joints."
            raise ConfigurationError(text, name=name, values=list(values))
    return facts
