"""A teleoperator on the bench of the workflows: sends set points past the bus, in simulated time."""

from __future__ import annotations

import asyncio
import itertools
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from dataclasses import dataclass, field

from pcmrs.background import background_task
from pcmrs.messages import Command, DeviceEvent, TeleopSetpoint, TeleopStatus, Verdict
from pcmrs.messages.teleop import AT_REST, Twist
from pcmrs.spatial import Transform
from pcmrs.workflows.data import as_transform
from tests.unit.workflows.workflow_bench import WorkflowBench

PERIOD = 0.02
AHEAD = 1000.0
"""The teleoperator's clock is another one, s."""


@dataclass
class Teleoperator:
    """Sends set points at 50 Hz for as long as `sending`.

    Attributes:
        bench: Where.
        user: Under which name they arrive.
        twist: What is asked for.
        late: How long each set point is on its way, s.
        heard: Every status that was published.
    """

    bench: WorkflowBench
    user: str = "alice"
    twist: Twist = AT_REST
    late: float = 0.0
    heard: list[TeleopStatus] = field(default_factory=list)
    sequence: int = 0

    @property
    def status(self) -> TeleopStatus:
        return self.heard[-1]

    async def ask(self, name: str) -> Verdict:
        branch, operation = name.split(".")
        ids = f"{self.user}-{next(_NUMBERS)}"
        source = f"bus:{self.user}"
        command = Command(
            id=ids, branch=branch, operation=operation, source=source, user=self.user, role="teleoperator"
        )
        return await self.bench.dispatcher.submit(command)

    async def engage(self) -> None:
        verdict = await self.ask("teleoperation.engage")
        assert verdict.decision == "accepted", verdict.reason

    def setpoint(self) -> TeleopSetpoint:
        """The next one."""
        self.sequence += 1
        return self.made(self.twist, sequence=self.sequence)

    def made(
        self, twist: Twist, *, sequence: int = 5000, seen: float | None = None, ttl: float = 1.0
    ) -> TeleopSetpoint:
        """One that is not sent."""
        seen = self.status.stamp if seen is None else seen
        return TeleopSetpoint(sequence=sequence, sent=AHEAD + self.now, seen=seen, ttl=ttl, twist=twist)

    @property
    def now(self) -> float:
        return self.bench.clock.monotonic()

    def send(self, setpoint: TeleopSetpoint | None = None) -> None:
        self.bench.cell.teleop.receive(self.user, setpoint or self.setpoint())

    async def send_late(self, setpoint: TeleopSetpoint) -> None:
        await self.bench.clock.sleep(self.late)
        self.send(setpoint)

    async def fall_behind(self, late: float) -> None:
        """From now on set points are on their way for so long, s: more with each, so that there is no gap."""
        while self.late < late:
            self.late += 0.01
            await self.bench.clock.sleep(PERIOD)
        await self.bench.clock.sleep(self.late + 2 * PERIOD)

    @asynccontextmanager
    async def sending(self) -> AsyncIterator[None]:
        """Set points as the client sends them."""

        async def run() -> None:
            async with asyncio.TaskGroup() as group:
                while True:
                    group.create_task(self.send_late(self.setpoint()))
                    await self.bench.clock.sleep(PERIOD)

        async with background_task(run()):
            yield

    async def steer(self, twist: Twist, seconds: float) -> None:
        """Asks for a twist for so long, then for rest until the tool stands."""
        self.twist = twist
        await self.bench.clock.sleep(seconds)
        self.twist = AT_REST
        await self.bench.clock.sleep(0.5)


_NUMBERS = itertools.count(1)


async def guided(bench: WorkflowBench, *, placed: bool = False) -> Teleoperator:
    """A tool that may be guided, from the standoff or from its place, and a teleoperator who hears the statuses."""
    await (bench.to_placed() if placed else bench.to_standoff())
    teleoperator = Teleoperator(bench)
    bench.cell.teleop.publish = teleoperator.heard.append
    assert (await bench.accept("placement.guide")).state == "guided"
    await bench.until(lambda: bool(teleoperator.heard))
    return teleoperator


async def tool(bench: WorkflowBench) -> Transform:
    """``tracker_from_coil`` as it truly is."""
    return as_transform((await bench.scene.truth()).tracker_from_coil)


async def moved(bench: WorkflowBench, before: Transform) -> tuple[float, float, float]:
    """How far the tool has gone since, along the axes that it had then, m."""
    x, y, z = (before.inverse() @ await tool(bench)).translation.tolist()
    return x, y, z


def danger(bench: WorkflowBench) -> DeviceEvent:
    """The last danger."""
    return [each for each in bench.published if isinstance(each, DeviceEvent) and each.danger][-1]


async def still(bench: WorkflowBench, before: Transform) -> bool:
    """Whether the tool is where it was, but for what the arm gives way."""
    return max(map(abs, await moved(bench, before))) < 2e-4


async def held(bench: WorkflowBench) -> None:
    """Waits until the tool is not guided any more: held, latched, the clutch open, and at rest for good."""
    await bench.until(lambda: bench.states["placement"] != "guided")
    assert (bench.states["placement"], bench.states["teleoperation"]) == ("held", "off")
    assert bench.dispatcher.snapshot().latched
    await bench.until(lambda: bench.speed() < 1e-3)
    where = await tool(bench)
    await bench.clock.sleep(1.0)
    assert await still(bench, where)
