"""One teleoperator at work: engages while the clutch is held, sends set points, and always ends the guiding."""

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
"""A set point is refused if its sender has received nothing from the daemon for longer than this, s."""
PATIENCE = 5.0
"""The status of a guided tool, and the answer to a release, must arrive within this, s."""

GUIDED = "guided"
ENDED = ("activity:teleoperate", "activity_ended")
"""Device and code of the event that the arm has stopped being guided."""

Report = Verdict | DeviceEvent
Reporter = Callable[[Report], None]


class TeleopSession:
    """Guiding of the tool by one teleoperator; see `run`.

    Args:
        client: Client of the cell.
        device: Input device.
        clock: Clock of this machine.
        rate: Set points per second.
        report: Called with every refusal, and every event that is a danger.

    Attributes:
        status: Newest status from the daemon; None before the first.
    """

    def __init__(self, client: Client, device: InputDevice, clock: Clock, rate: float, report: Reporter) -> None:
        self._client, self._device, self._clock = client, device, clock
        self._period, self._report = 1.0 / rate, report
        self._sequence = 0
        self._request: asyncio.Task[Verdict] | None = None
        self._closed, self._may_engage = False, True
        self._placement, self._since = "", 0
        self._status_received, self._stands = asyncio.Event(), asyncio.Event()
        self.status: TeleopStatus | None = None

    async def run(self) -> str:
        """Guide until the teleoperator leaves or the tool cannot be guided any more.

        Returns:
            The reason why it cannot be guided; empty if the teleoperator has left.

        Raises:
            CommandRefusedError: The tool may not be guided now.
            UnknownOutcomeError: The daemon is silent.
        """
        async with AsyncExitStack() as stack:
            client = self._client
            for unsubscribe in (
                client.listen("state/teleop", TeleopStatus, self._take_status),
                client.listen("state/fsm", Snapshot, self._take_snapshot),
                client.listen("state/event", dict, self._take_event),
            ):
                stack.push_async_callback(unsubscribe)
            stack.push_async_callback(self._end)
            await self._start_guiding()
            return await self._work()

    @property
    def engaged(self) -> bool:
        """The daemon accepts the set points of this session."""
        return self.status is not None and self.status.user == self._client.user

    async def _start_guiding(self) -> None:
        shown = await self._client.state()
        self._since = shown.sequence
        if shown.branches["placement"] != GUIDED:
            verdict = await self._client.call("placement.guide")
            _check_accepted(verdict)
            self._since = verdict.sequence
        self._placement = GUIDED
        try:
            async with self._clock.timeout(PATIENCE):
                await self._status_received.wait()
        except TimeoutError:
            text = f"The daemon has not reported the state of the guiding within {PATIENCE:g} s: look at the cell."
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
        return f"The tool is no longer guided: it is {self._placement}. Decide at the cell how to continue."

    def _clutch(self, demand: Demand) -> None:
        """Make the daemon's clutch follow the teleoperator's, one request at a time."""
        self._take_answer()
        if not demand.clutch:
            self._may_engage = True  # after a refusal, or a release by others, the clutch must be opened first
        if self._request is not None or demand.clutch == self._closed:
            return
        if not demand.clutch:
            self._request_clutch("release")
        elif self._may_engage:
            self._request_clutch("engage")

    def _request_clutch(self, operation: str) -> None:
        self._closed = operation == "engage"
        self._may_engage = False
        self._request = asyncio.create_task(self._client.call(f"teleoperation.{operation}"))

    def _take_answer(self) -> None:
        if self._request is None or not self._request.done():
            return
        verdict, self._request = self._request.result(), None
        if verdict.decision != "accepted":
            self._closed = False
            self._report(verdict)

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
            # Until the release is accepted, set points at rest stop the tool.
            twist=demand.twist if demand.clutch else AT_REST,
        )
        self._client.steer(setpoint)

    async def _end(self) -> None:
        """Wait until the tool stands and the clutch is open; if the daemon does not answer, silence opens it."""
        with suppress(PcmrsError):
            if self._request is not None:
                await asyncio.wait([self._request], timeout=PATIENCE)
                self._request.cancel()
            if self._placement == GUIDED:
                await self._client.call("placement.stop_guiding", timeout=PATIENCE)
                with suppress(TimeoutError):
                    async with self._clock.timeout(PATIENCE):
                        await self._stands.wait()

    def _take_status(self, status: TeleopStatus) -> None:
        before, self.status = self.engaged, status
        if before and not self.engaged:
            self._closed = False
        self._status_received.set()

    def _take_snapshot(self, snapshot: Snapshot) -> None:
        # A snapshot from before the verdict may arrive after it, and would end the guiding at once.
        if snapshot.sequence >= self._since:
            self._placement = snapshot.branches["placement"]

    def _take_event(self, fields: dict[str, Any]) -> None:
        if (fields.get("device"), fields.get("code")) == ENDED:
            self._stands.set()
        if fields.get("danger"):
            self._report(convert(fields, DeviceEvent))


def _check_accepted(verdict: Verdict) -> None:
    if verdict.decision != "accepted":
        why = verdict.reason.text if verdict.reason is not None else verdict.decision
        raise CommandRefusedError(f"The tool may not be guided now: {why}", verdict=verdict)
