"""OpenIGTLink messages from a TCP stream, and tracker frames from single transforms: one time stamp is one frame."""

from __future__ import annotations

import asyncio
import math
import struct
from collections.abc import Collection, Mapping
from typing import Any

from pyigtl.messages import MessageBase

from pcmrs.devices.plus.messages import Reading, unpack
from pcmrs.messages import BodyPose
from pcmrs.spatial import Transform

HEADER_BYTES = 58
"""Length of a header, bytes."""
MAX_BODY = 1 << 20
"""Longest body that is read, bytes; a longer one is skipped."""
CHUNK = 1 << 16
"""Number of bytes that are skipped at once."""

_SIZE_AND_CRC = struct.Struct(">QQ")


class MessageReader:
    """Reader of messages, one after the other; a cancelled read loses nothing.

    Args:
        stream: Stream of the connection.
        kinds: Types of messages that are read, such as ``TRANSFORM``; all others are skipped.

    Attributes:
        version: Greatest header version of all messages so far, also of skipped ones; 0 before the first.
    """

    def __init__(self, stream: asyncio.StreamReader, kinds: Collection[str]) -> None:
        self.version = 0
        self._stream = stream
        self._kinds = kinds
        self._header: bytes | None = None
        self._left_to_skip = 0

    async def read(self) -> Any | None:
        """Return the next message as a `pyigtl` message; None for one of another type.

        Raises:
            PayloadError: A message is damaged; the next one can be read.
            ConnectionError: The stream is not OpenIGTLink, so nothing after this can be read.
            asyncio.IncompleteReadError: The other side has closed the connection.
        """
        if self._left_to_skip:
            await self._skip()
            return None
        if self._header is None:
            self._header = await self._stream.readexactly(HEADER_BYTES)
        header, (size, crc) = _parse(self._header), _SIZE_AND_CRC.unpack_from(self._header, 42)
        self.version = max(self.version, header["header_version"])
        if header["message_type"] not in self._kinds or size > MAX_BODY:
            self._header, self._left_to_skip = None, size
            await self._skip()
            return None
        body = await self._stream.readexactly(size)
        self._header = None
        return unpack(header, crc, body)

    async def _skip(self) -> None:
        while self._left_to_skip:
            data = await self._stream.read(min(self._left_to_skip, CHUNK))
            if not data:
                raise asyncio.IncompleteReadError(b"", self._left_to_skip)
            self._left_to_skip -= len(data)


def _parse(header: bytes) -> dict[str, Any]:
    try:
        fields: dict[str, Any] = MessageBase.parse_header(header)
    except UnicodeDecodeError:
        fields = {"header_version": None}
    if fields["header_version"] not in (1, 2):
        raise ConnectionAbortedError("it sent no OpenIGTLink header of version 1 or 2")
    return fields


AGREEMENT = 0.5
"""Greatest age of the first time stamp if the two clocks agree, s; it must not be in the future."""
APART = 0.01
"""Greatest difference between two synchronized clocks, s: the error of NTP."""


class FrameAssembler:
    """Collector of the readings of one time stamp; a time stamp that does not advance belongs to the same frame.

    Time stamps are Unix seconds of the server. If its clock agrees with ours, a frame was captured at its time stamp,
    however late it arrives; otherwise `latency` before it arrived. The first time stamp decides this. After our wall
    clock was set, it is decided again when a time stamp follows the new time; time stamps that continue as before keep
    their meaning.

    Args:
        bodies: Body of each transform, by the name of the transform.
        latency: Time from exposure to arrival if the clocks do not agree, s.
    """

    def __init__(self, bodies: Mapping[str, str], latency: float) -> None:
        self._bodies = bodies
        self._latency = latency
        self._number = 0
        self.restart()

    @property
    def waiting(self) -> bool:
        """True if the present frame still lacks bodies."""
        return bool(self._found)

    def restart(self) -> None:
        """Accept any next time stamp, as after a new connection; frame numbers continue."""
        self._found: dict[str, Reading] = {}
        self._stamp = -math.inf
        self._arrived = 0.0
        self._monotonic_from_unix = 0.0
        self._agree = False

    def take(
        self, found: Mapping[str, Reading], stamp: float, now: float, wall: float, *, whole: bool = False
    ) -> list[list[BodyPose]]:
        """Take the readings of a message, and return the frames that are complete now.

        Args:
            found: Readings by the name of the transform; names of no body are ignored.
            stamp: Time stamp of the message, Unix seconds.
            now: Time of the monotonic clock, s.
            wall: Time of the wall clock, Unix seconds.
            whole: True if no other message has this time stamp.
        """
        known = {self._bodies[name]: reading for name, reading in found.items() if name in self._bodies}
        clock_was_set = stamp != self._stamp and self._was_set(stamp, now, wall)
        ready = [self.finish(now)] if self._found and (clock_was_set or stamp > self._stamp) else []
        if clock_was_set:
            self.restart()
        if not known or stamp < self._stamp or (stamp == self._stamp and not self._found):
            return ready  # older than the last frame, or a repetition of it
        if stamp > self._stamp:
            self._begin(stamp, now, wall)
        self._found |= known
        if whole or len(self._found) == len(self._bodies):
            ready.append(self.finish(now))
        return ready

    def finish(self, now: float) -> list[BodyPose]:
        """Return the present frame; bodies without a reading are not visible in it."""
        self._number += 1
        found, self._found = self._found, {}
        return [self._pose(body, found.get(body, "not_sent"), now) for body in self._bodies.values()]

    def _was_set(self, stamp: float, now: float, wall: float) -> bool:
        """Return True if our wall clock was set since the first time stamp, and this one follows the new time."""
        moved = abs(now - wall - self._monotonic_from_unix)
        return self._stamp > -math.inf and moved > APART and -APART <= wall - stamp <= AGREEMENT

    def _begin(self, stamp: float, now: float, wall: float) -> None:
        if self._stamp == -math.inf:
            self._monotonic_from_unix = now - wall
            self._agree = 0.0 <= wall - stamp <= AGREEMENT
        self._stamp, self._arrived = stamp, now

    def _pose(self, body: str, reading: Reading, now: float) -> BodyPose:
        captured = self._stamp + self._monotonic_from_unix if self._agree else self._arrived - self._latency
        if not isinstance(reading, Transform):
            return BodyPose(
                body=body, frame_number=self._number, captured=captured, sent=now, valid=False, reason=reading
            )
        x, y, z = reading.translation.tolist()
        w, i, j, k = reading.quat_wxyz.tolist()
        return BodyPose(
            body=body,
            frame_number=self._number,
            captured=captured,
            sent=now,
            valid=True,
            position=(x, y, z),
            quat_wxyz=(w, i, j, k),
        )
