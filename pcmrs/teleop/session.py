"""One teleoperator at work: engages while the clutch is held, sends set points, and ends the guiding in any case."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from contextlib import AsyncExitStack, suppress
from typing import Any

from pcmrs.bus.codec import convert
from pcmrs.client import Client
from pcmrs.clock import Clock
from pcmrs.errors import CommandRefusedError, PcmrsError, UnknownOutcomeError
from pcmrs.messages import DeviceEvent, Snapshot, TeleopSetpoint, TeleopStatus, Verdict
from pcmrs.messages.teleop import AT_REST
from pcmrs.teleop.demand import Demand, InputDevice

TTL = 1.0
"""A set point whose sender has heard nothing newer of the daemon than this is refused, s."""
PATIENCE = 5.0
"""A tool that may be guided is told of within this, s, and a release is answered."""

GUIDED = "guided"
ENDED = ("activity:teleoperate", "activity_ended")
"""Device and code of the event that the arm is not moved any more."""

Told = Verdict | DeviceEvent
Tell = Callable[[Told], None]


class TeleopSession:
    """Use `run`.

    Args:
        client: Of the cell.
        device: What hands move.
        clock: The machine's.
        rate: Set points per second.
        tell: Called with every refusal, and every danger.

    Attributes:
        status: Newest of the daemon; None before the first.
    """

    def __init__(self, client: Client, device: InputDevice, clock: Clock, rate: float, tell: Tell) -> None:
        self._client, self._device, self._clock = client, device, clock
        self._period, self._tell = 1.0 / rate, tell
        self._sequence = 0
        self._asking: asyncio.Task[Verdict] | None = None
        self._closed, self._may_engage = False, True
        self._placement, self._since = "", 0
        self._heard, self._stands = asyncio.Event(), asyncio.Event()
        self.status: TeleopStatus | None = None

    async def run(self) -> str:
        """Guide until the teleoperator leaves or the tool cannot be guided any more.

        Returns:
            Why it cannot; empty where the teleoperator has left.

        Raises:
            CommandRefusedError: The tool may not be guided now.
            UnknownOutcomeError: The daemon is silent.
        """
        async with AsyncExitStack() as ends:
            client = self._client
            for end in (
                client.listen("state/teleop", TeleopStatus, self._take_status),
                client.listen("state/fsm", Snapshot, self._take_snapshot),
                client.listen("state/event", dict, self._take_event),
            ):
                ends.push_async_callback(end)
            ends.push_async_callback(self._end)
            await self._have_it_guided()
            return await self._work()

    @property
    def engaged(self) -> bool:
        """Whether the daemon takes our set points."""
        return self.status is not None and self.status.user == self._client.user

    async def _have_it_guided(self) -> None:
        shown = await self._client.state()
        self._since = shown.sequence
        if shown.branches["placement"] != GUIDED:
            verdict = await self._client.call("placement.guide")
            _check_accepted(verdict)
            self._since = verdict.sequence
        self._placement = GUIDED
        try:
            async with self._clock.timeout(PATIENCE):
                await self._heard.wait()
        except TimeoutError:
            text = f"The daemon has not told how the guiding goes within {PATIENCE:g} s: look at the cell."
            raise UnknownOutcomeError(text) from None

    async def _work(self) -> str:
        while self._placement == GUIDED:
            demand = self._device.demand(self._clock.monotonic())
            if demand.stop:
                await self._client.stop()
            if demand.leave:
                return ""
            self._clutch(demand)
            self._send(demand)
            await self._clock.sleep(self._period)
        return f"The tool is not guided any more: it is {self._placement}. How to go on is decided at the cell."

    def _clutch(self, demand: Demand) -> None:
        """Have the daemon's clutch do as the teleoperator's does, one request at a time."""
        self._hear_answer()
        if not demand.clutch:
            self._may_engage = True  # whoever was refused, or released by others, has to let go first
        if self._asking is not None or demand.clutch == self._closed:
            return
        if not demand.clutch:
            self._ask("release")
        elif self._may_engage:
            self._ask("engage")

    def _ask(self, operation: str) -> None:
        self._closed = operation == "engage"
        self._may_engage = False
        self._asking = asyncio.create_task(self._client.call(f"teleoperation.{operation}"))

    def _hear_answer(self) -> None:
        if self._asking is None or not self._asking.done():
            return
        verdict, self._asking = self._asking.result(), None
        if verdict.decision != "accepted":
            self._closed = False
            self._tell(verdict)

    def _send(self, demand: Demand) -> None:
        status = self.status
        if status is None or not self.engaged:
            return
        self._sequence += 1
        setpoint = TeleopSetpoint(
            sequence=self._sequence,
            sent=self._clock.monotonic(),
            seen=status.stamp,
            ttl=TTL,
            twist=demand.twist if demand.clutch else AT_REST,
        )
        self._client.steer(setpoint)

    async def _end(self) -> None:
        """Return when the tool stands and the clutch is open; silence brings that about where nobody answers."""
        with suppress(PcmrsError):
            if self._asking is not None:
                await asyncio.wait([self._asking], timeout=PATIENCE)
                self._asking.cancel()
            if self._placement == GUIDED:
                await self._client.call("placement.stop_guiding", timeout=PATIENCE)
                with suppress(TimeoutError):
                    async with self._clock.timeout(PATIENCE):
                        await self._stands.wait()

    def _take_status(self, status: TeleopStatus) -> None:
        before, self.status = self.engaged, status
        if before and not self.engaged:
            self._closed = False
        self._heard.set()

    def _take_snapshot(self, snapshot: Snapshot) -> None:
        if snapshot.sequence >= self._since:
            self._placement = snapshot.branches["placement"]

    def _take_event(self, fields: dict[str, Any]) -> None:
        if (fields.get("device"), fields.get("code")) == ENDED:
            self._stands.set()
        if fields.get("danger"):
            self._tell(convert(fields, DeviceEvent))


def _check_accepted(verdict: Verdict) -> None:
    if verdict.decision != "accepted":
        why = verdict.reason.text if verdict.reason is not None else verdict.decision
        raise CommandRefusedError(f"The tool may not be guided now: {why}", verdict=verdict)
