"""Simulated operator, who requests one operation after the other and waits if it is too early."""

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
"""Pause between two requests, s of the machine."""
PATIENCE = 20.0
"""Longest time for which a request is repeated, s of the machine: a busy one publishes poses late."""
TEMPORARY = frozenset(
    {"busy", "coil_off_target", "head_moves", "not_aligned", "pose_missing", "pose_stale", "pulse_too_soon"}
)
"""Codes of reasons that are temporary."""
PLACE_AND_ARM = frozenset({"invalid_in_state", "not_aligned", "not_armed", "not_placed", "stimulator_not_ready"})
"""Codes of reasons against a pulse that are solved by placing and arming again: stimulators disarm after a time."""
ATTEMPTS = 4
"""Largest number of failures: a robot that misses its set points holds."""
TO_PLACED = {
    "unknown": "placement.locate",
    "held": "placement.back_off",
    "retracted": "placement.approach",
    "replanned": "placement.approach",
    "standoff": "placement.confirm",
    "following": "placement.stop_following",
}
"""Operation that leads to the planned pose, by state of the placement."""
AWAY = dict.fromkeys(("placed", "following", "replanned", "held"), "placement.back_off")
"""Operation that leads away from the body, by state of the placement."""


class SessionOperator:
    """Operator of a daemon on the bus.

    Args:
        client: Client of the daemon.
        rate: Seconds of the cell per second of the machine.
        interval: Shortest time between two pulses, s of the cell.
    """

    def __init__(self, client: Client, rate: float, interval: float = 0.0) -> None:
        self._client = client
        self._rate = rate
        self._interval = interval
        self._next_pulse_at = -math.inf
        self._changed = asyncio.Event()
        self._snapshot: Snapshot | None = None
        client.listen("state/fsm", Snapshot, self._receive)

    async def request(self, name: str, arguments: Mapping[str, Any] | None = None) -> Verdict:
        """Request an operation, again while the reason against it is temporary.

        Args:
            name: Branch and operation, joined by a dot.
            arguments: Arguments of the operation.

        Returns:
            Verdict that accepted it.

        Raises:
            CommandRefusedError: It is not accepted; the text is the reason.
        """
        verdict = await self._attempt(name, arguments)
        if verdict.decision != "accepted":
            raise refused(verdict)
        return verdict

    async def state(self, branch: str) -> str:
        """Return the present state of a branch."""
        return (await self._client.state()).branches[branch]

    async def place(self) -> None:
        """Bring the coil to the planned pose from any state. Raises `CommandRefusedError`."""
        await self._follow(TO_PLACED)

    async def withdraw(self) -> None:
        """Disarm, and bring the coil home, or at least clear of the body, from any state.

        From some poses the path home leads back towards the body, which is refused. Without a plan there is no
        standoff: then backing off continues until the coil is clear of the body. The coil stays there if the path is
        still refused.

        Raises:
            CommandRefusedError: The daemon refuses a step.
        """
        await self.request("stimulation.disarm")
        await self._follow(AWAY)
        if (await self._attempt("placement.home")).decision != "accepted":
            await self.request("toolplan.clear")
            await self._follow(AWAY)
            await self._attempt("placement.home")

    async def fire(self, name: str) -> Verdict:
        """Give one pulse as soon as it is allowed; place the coil and arm the stimulator again if necessary.

        Raises:
            CommandRefusedError: The pulse is refused; the text is the reason.
        """
        for _ in range(ATTEMPTS):
            await self.place()
            await self._ready()
            verdict = await self._attempt(name)
            if verdict.reason is None or verdict.reason.code not in PLACE_AND_ARM:
                break
        if verdict.decision != "accepted":
            raise refused(verdict)
        self._next_pulse_at = asyncio.get_running_loop().time() + self._interval / self._rate
        return verdict

    async def _ready(self) -> None:
        """Arm the stimulator if necessary, and wait until the next pulse is due and the coil is aligned."""
        if await self.state("stimulation") != "armed":
            await self.request("stimulation.arm")
        await asyncio.sleep(self._next_pulse_at - asyncio.get_running_loop().time())
        with suppress(TimeoutError):  # the daemon then says what is missing
            async with asyncio.timeout(PATIENCE):
                await self._wait_for(lambda snapshot: snapshot.branches["alignment"] == "1")

    async def _follow(self, leads: Mapping[str, str]) -> None:
        """Request the operation that the present state leads to, until no further one is given."""
        failures = 0
        verdict: Verdict | None = None
        while (state := (snapshot := await self._client.state()).branches["placement"]) in leads:
            if snapshot.latched:
                acknowledged = await self._client.acknowledge(stop=snapshot.stop.number)
                if acknowledged.reason is not None and acknowledged.reason.code == "stop_outdated":
                    continue  # the newer one must be seen first
                if acknowledged.decision != "accepted":  # what latched says more: the link to the robot may be lost
                    raise refused(verdict or acknowledged)
            verdict = await self._attempt(leads[state])
            failures += verdict.decision != "accepted" or verdict.state == state
            if failures == ATTEMPTS:
                raise refused(verdict)

    async def _attempt(self, name: str, arguments: Mapping[str, Any] | None = None) -> Verdict:
        """Return the final decision of the daemon, after temporary reasons."""
        loop = asyncio.get_running_loop()
        until = loop.time() + PATIENCE
        while True:
            verdict = await self._client.call(name, arguments)
            if verdict.reason is None or verdict.reason.code not in TEMPORARY or loop.time() > until:
                return verdict
            await asyncio.sleep(max(PAUSE, float(verdict.reason.fields.get("wait", 0.0)) / self._rate))

    async def _wait_for(self, wanted: Callable[[Snapshot], bool]) -> None:
        self._snapshot = self._snapshot or await self._client.state()
        while not wanted(self._snapshot):
            self._changed.clear()
            await self._changed.wait()

    def _receive(self, snapshot: Snapshot) -> None:
        self._snapshot = snapshot
        self._changed.set()


def refused(verdict: Verdict) -> CommandRefusedError:
    """Return the error for a verdict that did not accept."""
    reason = "the reason is unknown." if verdict.reason is None else verdict.reason.text
    name = f"{verdict.branch}.{verdict.operation}"
    return CommandRefusedError(f"{name} was {verdict.decision} in {verdict.state}: {reason}", verdict=verdict)
