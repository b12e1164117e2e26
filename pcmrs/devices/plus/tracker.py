"""The client of a PLUS server: connects, reads, and connects again."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Mapping, Sequence
from typing import Any

import structlog

from pcmrs.clock import Clock
from pcmrs.devices.plus.frames import Frames, MessageReader
from pcmrs.devices.plus.messages import StartTrackingDataMessage, readings
from pcmrs.devices.stream import Stream
from pcmrs.errors import PayloadError
from pcmrs.messages import BodyPose

KINDS = ("TRANSFORM", "TDATA")
CONNECT_WITHIN = 3.0
RETRY_AFTER = 1.0
SILENCE = 5.0
"""A server that has sent nothing for so long is connected anew, s; PLUS keeps a quiet connection alive by STATUS."""
TOGETHER_WITHIN = 0.005
"""The transforms of one frame come back to back; what has not come after so long was left out, s."""
LOG_PERIOD = 10.0

log = structlog.get_logger(__name__)


class PlusTracker:
    """Implements `pcmrs.devices.protocols.TrackerDriver`; while the server is absent there are no frames.

    Args:
        host: Of the server.
        port: Of the server.
        names: Body to the name of its transform into the tracker's frame.
        latency: From exposure to arrival where the server's clock does not agree with ours, s.
        clock: Stamps the frames.

    Attributes:
        trouble: Why there are no frames; empty while there are.
    """

    def __init__(self, host: str, port: int, names: Mapping[str, str], latency: float, clock: Clock) -> None:
        self._host, self._port = host, port
        self._clock = clock
        self._frames = Frames({name: body for body, name in names.items()}, latency)
        self._stream: Stream[Sequence[BodyPose]] = Stream()
        self._next_log = self._last_frame = clock.monotonic()
        self.trouble = f"The PLUS server at {host}:{port} has not been reached yet."

    def frames(self) -> AsyncIterator[Sequence[BodyPose]]:
        return self._stream.read()

    def close(self) -> None:
        """Ends all readers."""
        self._stream.close()

    async def run(self) -> None:
        """Connects and reads until cancelled, again and again."""
        while True:
            try:
                await self._connect_and_read()
            except asyncio.IncompleteReadError:
                self._complain("it has closed the connection")
            except TimeoutError:
                self._complain("it does not answer, or sends nothing")
            except OSError as error:
                self._complain(error.strerror or str(error))
            await self._clock.sleep(RETRY_AFTER)

    async def _connect_and_read(self) -> None:
        async with self._clock.timeout(CONNECT_WITHIN):
            stream, writer = await asyncio.open_connection(self._host, self._port)
        try:
            writer.write(StartTrackingDataMessage(device_name="PCMRS", timestamp=self._clock.wall()).pack())
            self._frames.restart()
            self._last_frame = self._clock.monotonic()
            reader = MessageReader(stream, KINDS)
            while True:
                await self._read_one(reader)
        finally:
            writer.close()

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
            self._complain(error.text)
        else:
            if message is not None:
                self._take(message)

    def _take(self, message: Any) -> None:
        now, wall = self._clock.monotonic(), self._clock.wall()
        whole = message.message_type == "TDATA"
        self._publish(self._frames.take(readings(message), message.timestamp, now, wall, whole=whole))

    def _publish(self, frames: Sequence[Sequence[BodyPose]]) -> None:
        """Hands frames to the readers; a connection of which none can be made is given up."""
        now = self._clock.monotonic()
        for frame in frames:
            self._last_frame = now
            self.trouble = ""
            self._stream.publish(frame)
        if now - self._last_frame > SILENCE:
            raise ConnectionAbortedError("its stamps do not advance, or it sends no transform that plus.names has")

    def _complain(self, why: str) -> None:
        """Keeps what is wrong, and logs it at most once per `LOG_PERIOD`."""
        do = "Start PlusServer, or set plus.host and plus.port."
        self.trouble = f"The PLUS server at {self._host}:{self._port}: {why}. {do}"
        now = self._clock.monotonic()
        if now >= self._next_log:
            self._next_log = now + LOG_PERIOD
            log.warning("plus_server", server=f"{self._host}:{self._port}", reason=why, do=do)
