"""Who asks for one operation after the other, and waits where it is too early."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Callable, Mapping
from contextlib import suppress
from typing import Any

from pcmrs.client import Client
from pcmrs.errors import CommandRefusedError
from pcmrs.messages import Snapshot, Verdict

PAUSE = 0.1
"""Between two questions, s of the machine."""
PATIENCE = 20.0
"""So long it is asked again at most, s of the machine: one that is busy shows poses late."""
PASSING = frozenset(
    {"busy", "coil_off_target", "head_moves", "not_aligned", "pose_missing", "pose_stale", "pulse_too_soon"}
)
"""Reasons that pass by themselves."""
AGAIN = frozenset({"invalid_in_state", "not_aligned", "not_armed", "not_placed", "stimulator_not_ready"})
"""Reasons against a pulse that placing and arming anew do away with: a stimulator disarms by itself after some time."""
ATTEMPTS = 4
"""So often something may fail: a robot that misses its set points holds."""
TO_PLACED = {
    "unknown": "placement.locate",
    "held": "placement.back_off",
    "retracted": "placement.approach",
    "standoff": "placement.confirm",
    "following": "placement.stop_following",
}
"""What leads to the planned pose, by state of the placement."""
AWAY = dict.fromkeys(("placed", "following", "held"), "placement.back_off")
"""What leads away from the body."""


class Operator:
    """Asks a daemon on the bus, and knows what it has shown of its states.

    Args:
        client: Of the daemon.
        rate: Of its cell.
        interval: Least time between two pulses, s of the cell.
    """

    def __init__(self, client: Client, rate: float, interval: float = 0.0) -> None:
        self._client = client
        self._rate = rate
        self._interval = interval
        self._rested = -math.inf
        self._told = asyncio.Event()
        self._shown: Snapshot | None = None
        client.listen("state/fsm", Snapshot, self._take)

    async def ask(self, name: str, arguments: Mapping[str, Any] | None = None) -> Verdict:
        """Ask for an operation until it is accepted; waits as long as the reason says, where it passes by itself.

        Raises:
            CommandRefusedError: It is not accepted; the text says why.
        """
        verdict = await self._attempt(name, arguments)
        if verdict.decision != "accepted":
            raise refused(verdict)
        return verdict

    async def state(self, branch: str) -> str:
        """The present state of a branch."""
        return (await self._client.state()).branches[branch]

    async def place(self) -> None:
        """Bring the coil to the planned pose, from wherever it is. Raises `CommandRefusedError`."""
        await self._go(TO_PLACED)

    async def withdraw(self) -> None:
        """Disarms, and brings the coil home, or at least clear of the body, from wherever it is.

        From some places the way home leads back towards the body, which is refused. Without a plan there is no
        standoff: then backing off goes on until the coil is clear of the body, and it stays there if the way is still
        refused.

        Raises:
            CommandRefusedError: The daemon does not let it.
        """
        await self.ask("stimulation.disarm")
        await self._go(AWAY)
        if (await self._attempt("placement.home")).decision != "accepted":
            await self.ask("toolplan.clear")
            await self._go(AWAY)
            await self._attempt("placement.home")

    async def fire(self, name: str) -> Verdict:
        """One pulse, as soon as it may be given; the coil is placed and the stimulator armed anew where need be.

        Raises:
            CommandRefusedError: It may not be given; the text says why.
        """
        for _ in range(ATTEMPTS):
            await self.place()
            await self._ready()
            verdict = await self._attempt(name)
            if verdict.reason is None or verdict.reason.code not in AGAIN:
                break
        if verdict.decision != "accepted":
            raise refused(verdict)
        self._rested = asyncio.get_running_loop().time() + self._interval / self._rate
        return verdict

    async def _ready(self) -> None:
        """Arm the stimulator where it is not, and waits until the next pulse is due and the coil counts as aligned."""
        if await self.state("stimulation") != "armed":
            await self.ask("stimulation.arm")
        await asyncio.sleep(self._rested - asyncio.get_running_loop().time())
        with suppress(TimeoutError):  # the daemon then says what is missing
            async with asyncio.timeout(PATIENCE):
                await self._shows(lambda snapshot: snapshot.branches["alignment"] == "1")

    async def _go(self, leads: Mapping[str, str]) -> None:
        """Ask for what leads on, state by state, until nothing does."""
        failures = 0
        verdict: Verdict | None = None
        while (state := (snapshot := await self._client.state()).branches["placement"]) in leads:
            if snapshot.latched:
                acknowledged = await self._client.acknowledge()
                if acknowledged.decision != "accepted":  # what latched says more: the link to the robot may be lost
                    raise refused(verdict or acknowledged)
            verdict = await self._attempt(leads[state])
            failures += verdict.decision != "accepted" or verdict.state == state
            if failures == ATTEMPTS:
                raise refused(verdict)

    async def _attempt(self, name: str, arguments: Mapping[str, Any] | None = None) -> Verdict:
        """What the daemon decides in the end, whatever it is."""
        loop = asyncio.get_running_loop()
        until = loop.time() + PATIENCE
        while True:
            verdict = await self._client.call(name, arguments)
            if verdict.reason is None or verdict.reason.code not in PASSING or loop.time() > until:
                return verdict
            await asyncio.sleep(max(PAUSE, float(verdict.reason.fields.get("wait", 0.0)) / self._rate))

    async def _shows(self, wanted: Callable[[Snapshot], bool]) -> None:
        self._shown = self._shown or await self._client.state()
        while not wanted(self._shown):
            self._told.clear()
            await self._told.wait()

    def _take(self, snapshot: Snapshot) -> None:
        self._shown = snapshot
        self._told.set()


def refused(verdict: Verdict) -> CommandRefusedError:
    """The error that says what was not accepted, and why."""
    why = "nobody knows why." if verdict.reason is None else verdict.reason.text
    name = f"{verdict.branch}.{verdict.operation}"
    return CommandRefusedError(f"{name} was {verdict.decision} in {verdict.state}: {why}", verdict=verdict)
