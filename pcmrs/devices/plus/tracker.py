"""Client of a PLUS server: connects, reads, and reconnects."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Mapping, Sequence
from typing import Any

import structlog

from pcmrs.clock import Clock
from pcmrs.devices.plus.frames import FrameAssembler, MessageReader
from pcmrs.devices.plus.messages import StartTrackingDataMessage, readings
from pcmrs.devices.stream import Stream
from pcmrs.errors import PayloadError
from pcmrs.messages import BodyPose

KINDS = ("TRANSFORM", "TDATA")
"""Types of messages that are read."""
CONNECT_WITHIN = 3.0
"""Longest wait for a connection, s."""
RETRY_AFTER = 1.0
"""Pause between two attempts to connect, s."""
ANSWER_WITHIN = 2.0
"""Time without a frame and without a header of version 2 after which the server is asked with version 1, s; PLUS sends
STATUS more often."""
SILENCE = 5.0
"""Time without a frame after which the connection is made again, s; PLUS keeps a quiet connection alive by STATUS."""
TOGETHER_WITHIN = 0.005
"""Longest time between two transforms of one frame, s: they are sent back to back, and later ones were left out."""
LOG_PERIOD = 10.0
"""Shortest time between two log lines about an absent server, s."""

log = structlog.get_logger(__name__)


class PlusTracker:
    """Implementation of `pcmrs.devices.protocols.TrackerDriver`; there are no frames while the server is absent.

    Args:
        host: Host name or address of the server.
        port: TCP port of the server.
        names: Name of the transform from each body to the tracker frame.
        latency: Time from exposure to arrival if the server's clock does not agree with ours, s.
        clock: Clock for the time stamps of the frames.

    Attributes:
        trouble: Reason why there are no frames; empty while there are.
    """

    def __init__(self, host: str, port: int, names: Mapping[str, str], latency: float, clock: Clock) -> None:
        self._host, self._port = host, port
        self._clock = clock
        self._names = frozenset(names.values())
        self._frames = FrameAssembler({name: body for body, name in names.items()}, latency)
        self._stream: Stream[Sequence[BodyPose]] = Stream()
        self._next_log = self._last_frame = clock.monotonic()
        self._has_frames = False
        self.trouble = f"The PLUS server at {host}:{port} has not been reached yet."

    def frames(self) -> AsyncIterator[Sequence[BodyPose]]:
        return self._stream.read()

    def close(self) -> None:
        """End all readers."""
        self._stream.close()

    async def run(self) -> None:
        """Connect and read until cancelled; reconnect after each failure."""
        while True:
            try:
                await self._connect_and_read()
            except asyncio.IncompleteReadError:
                self._log_failure("it has closed the connection")
            except TimeoutError:
                self._log_failure("it does not answer, or sends nothing")
            except OSError as error:
                self._log_failure(error.strerror or str(error))
            await self._clock.sleep(RETRY_AFTER)

    async def _connect_and_read(self) -> None:
        async with self._clock.timeout(CONNECT_WITHIN):
            stream, writer = await asyncio.open_connection(self._host, self._port)
        try:
            self._ask(writer, 2)
            self._frames.restart()
            self._last_frame, self._has_frames = self._clock.monotonic(), False
            reader = MessageReader(stream, KINDS)
            if not await self._is_answered(reader):
                self._ask(writer, 1)
            while True:
                await self._read_one(reader)
        finally:
            writer.close()

    async def _is_answered(self, reader: MessageReader) -> bool:
        """Read until a frame or a header of version 2 has come; return False if none does within `ANSWER_WITHIN`."""
        try:
            async with self._clock.timeout(ANSWER_WITHIN):
                while reader.version < 2 and not self._has_frames:
                    await self._read_one(reader)
        except TimeoutError:
            return False
        return True

    def _ask(self, writer: asyncio.StreamWriter, version: int) -> None:
        """Request TDATA in a message with a header of this version."""
        request = StartTrackingDataMessage(version, device_name="PCMRS", timestamp=self._clock.wall())
        writer.write(request.pack())

    async def _read_one(self, reader: MessageReader) -> None:
        waiting = self._frames.waiting
        try:
            async with self._clock.timeout(TOGETHER_WITHIN if waiting else SILENCE):
                message = await reader.read()
        except TimeoutError:
            if not waiting:
                raise
            self._publish([self._frames.finish(self._clock.monotonic())])
        except PayloadError as error:
            self._log_failure(error.text)
        else:
            if message is not None:
                self._take(message)

    def _take(self, message: Any) -> None:
        found = readings(message)
        if not message.timestamp and self._names & found.keys():
            raise ConnectionAbortedError("its poses have no time stamp, so that old ones would look new; send stamps")
        now, wall = self._clock.monotonic(), self._clock.wall()
        whole = message.message_type == "TDATA"
        self._publish(self._frames.take(found, message.timestamp, now, wall, whole=whole))

    def _publish(self, frames: Sequence[Sequence[BodyPose]]) -> None:
        """Publish frames to the readers; a connection that yields none for `SILENCE` is given up."""
        now = self._clock.monotonic()
        for frame in frames:
            self._last_frame, self._has_frames = now, True
            self.trouble = ""
            self._stream.publish(frame)
        if now - self._last_frame > SILENCE:
            raise ConnectionAbortedError("its stamps do not advance, or it sends no transform that plus.names has")

    def _log_failure(self, why: str) -> None:
        """Store the reason of a failure, and log it at most once per `LOG_PERIOD`."""
        do = "Start PlusServer, or set plus.host and plus.port."
        self.trouble = f"The PLUS server at {self._host}:{self._port}: {why}. {do}"
        now = self._clock.monotonic()
        if now >= self._next_log:
            self._next_log = now + LOG_PERIOD
            log.warning("plus_server", server=f"{self._host}:{self._port}", reason=why, do=do)
