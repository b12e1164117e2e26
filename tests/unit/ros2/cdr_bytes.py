"""CDR worked by hand from the specification, for bytes that another library has to agree with.

DDS-RTPS 2.5, 10.2: two bytes say the encoding (0x0001: plain CDR, little-endian), two are options. CORBA 3.3 part 2,
9.3: a number stands at a multiple of its size, counted from after that header; text is its length with the final zero,
then itself; a sequence is its length, then its members.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence

Numbers = Sequence[float]


class Bytes:
    """Appends values as CDR has them."""

    def __init__(self) -> None:
        self._body = b""

    def whole(self) -> bytes:
        return b"\x00\x01\x00\x00" + self._body

    def number(self, kind: str, value: float) -> Bytes:
        size = struct.calcsize(kind)
        self._body += b"\x00" * (-len(self._body) % size) + struct.pack(f"<{kind}", value)
        return self

    def text(self, value: str) -> Bytes:
        data = value.encode() + b"\x00"
        self.number("I", len(data))
        self._body += data
        return self

    def doubles(self, values: Numbers) -> Bytes:
        for value in values:
            self.number("d", value)
        return self

    def header(self, sec: int, nanosec: int, frame: str) -> Bytes:
        return self.number("i", sec).number("I", nanosec).text(frame)


def pose_stamped(sec: int, nanosec: int, frame: str, position: Numbers, quat_xyzw: Numbers) -> bytes:
    return Bytes().header(sec, nanosec, frame).doubles(position).doubles(quat_xyzw).whole()


def joint_state(sec: int, nanosec: int, frame: str, names: Sequence[str], *numbers: Numbers) -> bytes:
    out = Bytes().header(sec, nanosec, frame).number("I", len(names))
    for name in names:
        out.text(name)
    for values in numbers:
        out.number("I", len(values)).doubles(values)
    return out.whole()


def tf(links: Sequence[tuple[int, int, str, str, Numbers, Numbers]]) -> bytes:
    out = Bytes().number("I", len(links))
    for sec, nanosec, parent, child, translation, quat_xyzw in links:
        out.header(sec, nanosec, parent).text(child).doubles(translation).doubles(quat_xyzw)
    return out.whole()


def string(text: str) -> bytes:
    return Bytes().text(text).whole()
