"""Simulated operator with random but legal actions: mostly the next step, sometimes a step back, or Stop."""

from __future__ import annotations

import random
from typing import Any

from pcmrs.client import Client
from pcmrs.clock import SystemClock
from pcmrs.messages import Snapshot, Verdict
from pcmrs.testing.driving import landmarks, plan, tool_pose

STOPS = 0.05
"""Share of the steps that are Stop."""
GOES_BACK = 0.2
"""Share of the steps that lead back instead of forward, if a step back is legal."""

PAUSE = 0.1
"""Pause after a command that was not accepted, s of the machine, since another operation may be running."""

OperationCall = tuple[str, dict[str, Any]]
"""Operation and its arguments."""


class RandomOperator:
    """Operator of a cell over the bus.

    Args:
        client: Client of the cell.
        generator: Source of randomness.

    Attributes:
        verdicts: Verdicts by command id.
        stops: Number of Stops that were pressed and have begun.
    """

    def __init__(self, client: Client, generator: random.Random) -> None:
        self.verdicts: dict[str, Verdict] = {}
        self.stops = 0
        self._client = client
        self._generator = generator
        self._name = f"operator{generator.randrange(1 << 40):x}"
        self._commands = 0

    async def step(self) -> Verdict | None:
        """Request one operation and return its verdict; return None after Stop.

        Raises:
            UnknownOutcomeError: The daemon does not answer any more.
        """
        if self._generator.random() < STOPS:
            await self._client.stop()
            self.stops += 1
            return None
        name, arguments = self._choose(await self._client.state())
        command, self._commands = f"{self._name}-{self._commands}", self._commands + 1
        verdict = await self._client.call(name, arguments, id=command, timeout=60.0)
        self.verdicts[command] = verdict
        if verdict.decision != "accepted":
            await SystemClock().sleep(PAUSE)
        return verdict

    def _choose(self, snapshot: Snapshot) -> OperationCall:
        choices = steps_back(snapshot) if self._generator.random() < GOES_BACK else []
        return self._generator.choice(choices or [self._next_step(snapshot)])

    def _next_step(self, snapshot: Snapshot) -> OperationCall:
        """Return the next step of the procedure."""
        branches = snapshot.branches
        if branches["robot"] == "0":
            return "robot.connect", {}
        if snapshot.latched:
            return "robot.acknowledge", {"stop": snapshot.stop.number}
        if branches["placement"] in WAY_OUT:
            return WAY_OUT[branches["placement"]], {}
        if branches["registration"] != "111":
            return _register(branches)
        if branches["toolplan"] == "0":
            return "toolplan.plan", tool_pose(self._generator.randrange(len(plan().poses)))
        return NEXT[branches["placement"]], {}


WAY_OUT = {"unknown": "placement.locate", "held": "placement.back_off"}
NEXT = {
    "retracted": "placement.approach",
    "replanned": "placement.approach",
    "standoff": "placement.confirm",
    "placed": "placement.home",
}


def _register(branches: dict[str, str]) -> OperationCall:
    if branches["placement"] != "retracted":
        return "placement.home", {}
    if branches["registration"] == "000":
        return "registration.plan_landmarks", landmarks()
    return ("registration.register", {}) if branches["registration"] == "110" else ("digitization.digitize_all", {})


def steps_back(snapshot: Snapshot) -> list[OperationCall]:
    """Return the operations that lead back or away from the direct procedure, and are legal now."""
    branches = snapshot.branches
    if snapshot.latched or branches["robot"] == "0" or branches["placement"] in WAY_OUT:
        return []
    if branches["placement"] != "retracted":
        return [("placement.home", {}), ("placement.back_off", {})]
    return [
        ("registration.reinit", {}),
        ("registration.plan_landmarks", landmarks()),
        ("toolplan.clear", {}),
        ("robot.disconnect", {}),
    ]
