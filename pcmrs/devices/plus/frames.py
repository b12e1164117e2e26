"""Tracker frames out of single transforms: those of one stamp belong together.

OpenIGTLink messages out of a TCP stream, however it is cut into segments.
"""

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
MAX_BODY = 1 << 20
"""Longest body that is read, bytes; a longer one is skipped, whatever it holds."""
CHUNK = 1 << 16

_SIZE_AND_CRC = struct.Struct(">QQ")


class MessageReader:
    """Reads messages one after the other; a read that is cancelled loses nothing.

    Args:
        stream: The bytes.
        kinds: Types that are read, such as ``TRANSFORM``; all others are skipped.
    """

    def __init__(self, stream: asyncio.StreamReader, kinds: Collection[str]) -> None:
        self._stream = stream
        self._kinds = kinds
        self._header: bytes | None = None
        self._left_to_skip = 0

    async def read(self) -> Any | None:
        """The next message, as `pyigtl` has it; None for one of another type.

        Raises:
            PayloadError: A message is damaged; the next one can be read.
            ConnectionError: What comes is no OpenIGTLink, so that nothing behind it can be read.
            asyncio.IncompleteReadError: The other side has closed.
        """
        if self._left_to_skip:
            await self._skip()
            return None
        if self._header is None:
            self._header = await self._stream.readexactly(HEADER_BYTES)
        header, (size, crc) = _parse(self._header), _SIZE_AND_CRC.unpack_from(self._header, 42)
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
        raise ConnectionAbortedError("what came is no OpenIGTLink header of version 1 or 2")
    return fields


AGREEMENT = 0.5
"""Clocks agree when the first stamp is no younger than now and no older than this, s."""
APART = 0.01
"""By so much two clocks that are kept together may be apart, s: what NTP leaves."""


class Frames:
    """Collects the readings of one stamp; a stamp that does not advance is the same frame.

    Stamps are Unix seconds of the server. Where its clock agrees with ours, a frame was captured at its stamp, however
    late it comes; otherwise `latency` before it arrived. That is decided at the first stamp. After our wall clock was
    set it is decided anew when a stamp is of the new time; stamps that go on as before keep their meaning.

    Args:
        bodies: Name of a transform to the body it is of.
        latency: From exposure to arrival where the clocks do not agree, s.
    """

    def __init__(self, bodies: Mapping[str, str], latency: float) -> None:
        self._bodies = bodies
        self._latency = latency
        self._number = 0
        self.restart()

    @property
    def waiting(self) -> bool:
        """Whether a frame has begun that lacks bodies."""
        return bool(self._found)

    def restart(self) -> None:
        """Stamps may begin anew, as those of another connection do; frame numbers go on."""
        self._found: dict[str, Reading] = {}
        self._stamp = -math.inf
        self._arrived = 0.0
        self._monotonic_from_unix = 0.0
        self._agree = False

    def take(
        self, found: Mapping[str, Reading], stamp: float, now: float, wall: float, *, whole: bool = False
    ) -> list[list[BodyPose]]:
        """The frames that are complete now.

        Args:
            found: Transform name to reading; names of no body are left out.
            stamp: Of the message, Unix seconds.
            now: Of the monotonic clock, s.
            wall: Unix seconds.
            whole: Nothing else will come with this stamp.
        """
        known = {self._bodies[name]: reading for name, reading in found.items() if name in self._bodies}
        set_anew = stamp != self._stamp and self._was_set(stamp, now, wall)
        ready = [self.finish(now)] if self._found and (set_anew or stamp > self._stamp) else []
        if set_anew:
            self.restart()
        if not known or stamp < self._stamp or (stamp == self._stamp and not self._found):
            return ready  # older than what is out already, or that very frame again
        if stamp > self._stamp:
            self._begin(stamp, now, wall)
        self._found |= known
        if whole or len(self._found) == len(self._bodies):
            ready.append(self.finish(now))
        return ready

    def finish(self, now: float) -> list[BodyPose]:
        """The frame that has begun; a body that did not come with it is not seen."""
        self._number += 1
        found, self._found = self._found, {}
        return [self._pose(body, found.get(body, "not_sent"), now) for body in self._bodies.values()]

    def _was_set(self, stamp: float, now: float, wall: float) -> bool:
        """Whether our wall clock is another one than at the first stamp, and this stamp is of that one."""
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
