"""An operator who does random but legal things: mostly on with the procedure, now and then back, or Stop."""

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
"""Share of the steps that lead back instead of on, where there is such a way."""

PAUSE = 0.1
"""After what was not accepted, s of the machine: something else may be under way."""

Wish = tuple[str, dict[str, Any]]
"""An operation and its arguments."""


class RandomOperator:
    """Operates a cell over the bus.

    Args:
        client: Of the cell.
        generator: Of everything random.

    Attributes:
        verdicts: By command id: what was answered.
        stops: How often Stop was asked for, and begun.
    """

    def __init__(self, client: Client, generator: random.Random) -> None:
        self.verdicts: dict[str, Verdict] = {}
        self.stops = 0
        self._client = client
        self._generator = generator
        self._name = f"operator{generator.randrange(1 << 40):x}"
        self._asked = 0

    async def step(self) -> Verdict | None:
        """Asks for one thing and waits for its verdict; None after Stop.

        Raises:
            UnknownOutcomeError: The daemon has fallen silent.
        """
        if self._generator.random() < STOPS:
            await self._client.stop()
            self.stops += 1
            return None
        name, arguments = self._wish(await self._client.state())
        command, self._asked = f"{self._name}-{self._asked}", self._asked + 1
        verdict = await self._client.call(name, arguments, id=command, timeout=60.0)
        self.verdicts[command] = verdict
        if verdict.decision != "accepted":
            await SystemClock().sleep(PAUSE)
        return verdict

    def _wish(self, snapshot: Snapshot) -> Wish:
        wishes = back(snapshot) if self._generator.random() < GOES_BACK else []
        return self._generator.choice(wishes or [self._on(snapshot)])

    def _on(self, snapshot: Snapshot) -> Wish:
        """The next step of the procedure."""
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
NEXT = {"retracted": "placement.approach", "standoff": "placement.confirm", "placed": "placement.home"}


def _register(branches: dict[str, str]) -> Wish:
    if branches["placement"] != "retracted":
        return "placement.home", {}
    if branches["registration"] == "000":
        return "registration.plan_landmarks", landmarks()
    return ("registration.register", {}) if branches["registration"] == "110" else ("digitization.digitize_all", {})


def back(snapshot: Snapshot) -> list[Wish]:
    """What leads back, or away from the straight way, and is legal now."""
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
