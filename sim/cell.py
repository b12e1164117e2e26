"""The cell: all simulated devices in one process, stepped in the time of the clock."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Collection, Mapping
from contextlib import asynccontextmanager, suppress
from typing import Any

import structlog

from pcmrs.clock import Clock
from pcmrs.devices.protocols import Device
from pcmrs.errors import ConfigurationError
from pcmrs.kinematics.arms import ArmFacts
from pcmrs.kinematics.urdf_arms import find_arm
from sim.plant import STEP
from sim.pointer import SimPointer
from sim.robot import SimRobot
from sim.scene import SimScene
from sim.settings import ForceSettings, SimSettings, read_force_settings, read_settings
from sim.tracker import SimTracker
from sim.world import World

BATCH = 0.010
"""Time between wake-ups of the stepping task, s of the clock."""
LONGEST_CATCH_UP = 0.1
"""Time that one wake-up simulates at most, s; what is beyond is lost, and the cell's motions take longer."""

log = structlog.get_logger(__name__)


class Cell:
    """One world and its devices.

    Args:
        settings: Errors and geometry.
        facts: The arm.
        force: When the force on the tool is too great.
        clock: The cell keeps up with it as far as the processor can.

    Attributes:
        devices: Robot, tracker, pointer and scene by those names.
        lag: Time by which the simulation fell behind the clock in all, s.
    """

    def __init__(self, settings: SimSettings, facts: ArmFacts, force: ForceSettings, clock: Clock) -> None:
        self._clock = clock
        start = clock.monotonic()
        self._world = World(settings, facts, force, start)
        self._robot = SimRobot(self._world, clock, start)
        self._tracker = SimTracker(self._world, clock, start)
        pointer = SimPointer(self._world, clock)
        self.devices: Mapping[str, Device] = {
            "robot": self._robot,
            "tracker": self._tracker,
            "pointer": pointer,
            "scene": SimScene(self._world, self._robot, pointer),
        }
        self.lag = 0.0

    async def run(self) -> None:
        """Steps until cancelled; then no device publishes or answers any more."""
        try:
            while True:
                await self._clock.sleep(BATCH)
                self.advance(self._clock.monotonic())
        finally:
            self._robot.close()
            self._tracker.close()
            if self.lag:
                log.warning("the simulated cell was slower than its clock", lag=round(self.lag, 3))

    def advance(self, now: float) -> None:
        """Simulates up to `now`, s of the clock."""
        world = self._world
        lost = max(0.0, now - world.time - LONGEST_CATCH_UP)
        self.lag += lost
        world.time += lost
        while world.time + STEP <= now:
            due = min(self._robot.due, self._tracker.due, now)
            world.step(max(1, int((due - world.time) / STEP)))
            self._robot.update(world.time)
            self._tracker.update(world.time)


@asynccontextmanager
async def open_devices(
    devices: Collection[str], settings: Mapping[str, Any], clock: Clock
) -> AsyncIterator[Mapping[str, Any]]:
    """Opens the asked devices of one simulated cell; see `pcmrs.devices.protocols.OpenDriver`.

    Args:
        devices: Among ``robot``, ``tracker``, ``pointer`` and ``scene``.
        settings: The whole configuration; ``sim`` and ``robot`` are read.
        clock: The cell's clock.

    Raises:
        ConfigurationError: A device or the arm is unknown, or the table ``sim`` is wrong.
    """
    own = read_settings(settings)
    cell = Cell(own, _arm(settings, own), read_force_settings(settings), clock)
    unknown = sorted(set(devices) - set(cell.devices))
    if unknown:
        raise ConfigurationError(
            f"The simulated cell has no {', '.join(unknown)}; it has {', '.join(cell.devices)}.", unknown=unknown
        )
    stepping = asyncio.create_task(cell.run(), name="simulated cell")
    try:
        yield {name: cell.devices[name] for name in devices}
    finally:
        stepping.cancel()
        with suppress(asyncio.CancelledError):
            await stepping


def _arm(settings: Mapping[str, Any], own: SimSettings) -> ArmFacts:
    facts = find_arm(settings.get("robot", {}).get("model", "iiwa14"))
    for name, values in (("home", own.arm.home), ("stiffness", own.arm.stiffness)):
        if len(values) not in (0, len(facts.joints)):
            text = f"sim.arm.{name} holds {len(values)} numbers; {facts.name} has {len(facts.joints)} joints."
            raise ConfigurationError(text, name=name, values=list(values))
    return facts
