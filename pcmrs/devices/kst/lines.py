"""Framing: replies are lines, however the network splits and merges them."""

from __future__ import annotations

from pcmrs.errors import PayloadError

LONGEST = 512
"""Bytes of a reply without its end; seven numbers take 175 at most."""
END = b"\n"


class LineBuffer:
    """Collects bytes until lines are complete."""

    def __init__(self) -> None:
        self._rest = b""

    def feed(self, data: bytes) -> list[str]:
        """The lines that `data` completes, without their ends.

        Raises:
            PayloadError: A line is too long, or holds bytes that are not printable ASCII.
        """
        *lines, self._rest = (self._rest + data).split(END)
        for line in (*lines, self._rest):
            _check(line)
        return [line.decode("ascii") for line in lines]


def _check(line: bytes) -> None:
    if len(line) > LONGEST:
        text = f"A reply of the cabinet holds {len(line)} bytes without an end, limit {LONGEST}; is this a KST server?"
        raise PayloadError(text, bytes=len(line), limit=LONGEST)
    if any(not 0x20 <= byte < 0x7F for byte in line):
        raise PayloadError(f"A reply of the cabinet is no printable text: {line[:40]!r}; is this a KST server?")
