"""Heart of the daemon: sends the signs of life of its loop to the device nodes."""

from __future__ import annotations

import asyncio
import os
import uuid
from collections.abc import Callable
from contextlib import suppress
from typing import Protocol

import msgspec
import structlog

from pcmrs.bus import BusSettings
from pcmrs.bus.heart import SIGN, HeartSettings
from pcmrs.clock import Clock
from pcmrs.devices.node import DAEMON_BEAT
from pcmrs.messages import Beat, DeviceEvent
from pcmrs.processes.starting import Process, ProcessStarter
from pcmrs.service.processes.child import end_child
from pcmrs.service.supervisor import RESTARTS, WITHIN, RestartLimit, Supervisor

log = structlog.get_logger(__name__)

STARTING_TIME = 120.0
"""Limit for its first beat, s: on a busy machine a process takes long to start."""
ANSWER_TIME = 2.0
"""Limit between later beats, s; beyond it the process counts as hanging."""
ENDING_TIME = 2.0
"""Limit for its process to end after the last sign of life before it is killed, s."""


class BeatSender(Protocol):
    """Sender of beats.

    Attributes:
        session: Random id of this run of the daemon; in every beat.
    """

    session: str

    def sign(self, alive: float) -> None:
        """Send a sign of life of the loop, s of the machine's monotonic clock; never blocks."""

    def record_beat(self) -> None:
        """Note that one of its beats has arrived over the bus."""


class LoopHeart:
    """Sender of each sign of life from the loop itself, as in simulated time.

    Args:
        publish: `Bus.publish`.
        clock: The machine's.

    Attributes:
        session: See `BeatSender`.
    """

    def __init__(self, publish: Callable[[str, Beat], None], clock: Clock) -> None:
        self.session = uuid.uuid4().hex
        self._publish, self._clock = publish, clock
        self._number = 0

    def sign(self, alive: float) -> None:
        self._number += 1
        sent = self._clock.monotonic()
        self._publish(DAEMON_BEAT, Beat(number=self._number, session=self.session, alive=alive, sent=sent))

    def record_beat(self) -> None:
        """Ignore its own beats."""


class HeartProcess:
    """Sender of the signs of life from a small process, which waits for nothing else; see `pcmrs.bus.heart`.

    If that ends by itself, or hangs and is killed, no beats are sent, so that the nodes hold. It is restarted, up to a
    limit.

    Args:
        settings: Settings of the bus, for a client.
        clock: The machine's clock.
        device_key: Key of daemon and nodes to seal their messages.
        start_process: Starts the process.

    Attributes:
        session: See `BeatSender`.
        report: Takes the event that the process has ended by itself.
    """

    def __init__(self, settings: BusSettings, clock: Clock, device_key: bytes, start_process: ProcessStarter) -> None:
        self.session = uuid.uuid4().hex
        self._device_key = device_key
        self._start_process = start_process
        self.report: Callable[[DeviceEvent], None] = lambda _: None
        self._settings, self._clock = settings, clock
        self._number = 0
        self._answer_limit = STARTING_TIME
        self._unanswered_since: float | None = None
        self._pipe: int | None = None
        self._process: Process | None = None

    def sign(self, alive: float) -> None:
        self._number += 1
        if self._pipe is not None:
            # The pipe is full or broken: the process has ended or hangs, and nothing is sent.
            with suppress(BlockingIOError, BrokenPipeError):
                os.write(self._pipe, SIGN.pack(self._number, alive))
        self._unanswered_since = alive if self._unanswered_since is None else self._unanswered_since
        if self._process is not None and alive - self._unanswered_since > self._answer_limit:
            self._unanswered_since = None
            with suppress(ProcessLookupError):
                self._process.kill()  # the same follows as if it ends by itself

    def record_beat(self) -> None:
        self._answer_limit, self._unanswered_since = ANSWER_TIME, None

    def start(self, supervisor: Supervisor) -> None:
        """Start the process, and keep it running."""
        supervisor.start("heart", self._keep)

    async def stop(self) -> None:
        """Send no more signs, and wait until the process has ended."""
        self._close_pipe()
        if self._process is not None and not await end_child(self._process, ENDING_TIME):
            log.warning("heart_killed")

    async def _keep(self) -> None:
        limit = RestartLimit(RESTARTS, WITHIN, self._clock)
        while True:
            self._answer_limit, self._unanswered_since = STARTING_TIME, None
            process = self._process = await self._begin()
            status = await process.wait()
            self._close_pipe()
            given_up = limit.reached()
            log.error("heart_ended", status=status, given_up=given_up)
            self.report(_ended(status, given_up=given_up))
            if given_up:
                await asyncio.Event().wait()

    async def _begin(self) -> Process:
        reading, self._pipe = os.pipe()
        os.set_blocking(self._pipe, False)
        settings = HeartSettings(
            bus=self._settings,
            key=DAEMON_BEAT,
            session=self.session,
            device_key=self._device_key,
            daemon=os.getpid(),
        )
        os.write(self._pipe, msgspec.json.encode(settings) + b"\n")
        try:
            return await self._start_process("pcmrs.bus.heart", stdin=reading)
        finally:
            os.close(reading)

    def _close_pipe(self) -> None:
        pipe, self._pipe = self._pipe, None
        if pipe is not None:
            os.close(pipe)


def _ended(status: int, *, given_up: bool) -> DeviceEvent:
    text = f"The process that sends the daemon's heartbeats ended by itself (status {status})"
    if given_up:
        text += f" more than {RESTARTS} times within {WITHIN:g} s and is not restarted: nothing can move any more. "
        text += "The log says why it ends; restart the daemon when that is fixed."
    else:
        text += " and is restarted. What moved was held."
    fields = {"status": status}
    code = "heart_failed" if given_up else "heart_restarted"
    return DeviceEvent(device="daemon", code=code, text=text, danger=given_up, fields=fields)
