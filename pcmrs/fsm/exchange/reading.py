"""What all readers of foreign files share: limits, and how they say what is wrong."""

from __future__ import annotations

from typing import NoReturn

from pcmrs.errors import BlueprintError
from pcmrs.fsm.files.toml import MAX_BYTES
from pcmrs.fsm.finding import Finding

MAX_DEPTH = 64
"""Deepest nesting of elements or states that is read."""

Place = tuple[int, int]
"""Line and column in the file, from 1; 0 where there is none."""


class Findings(list[Finding]):
    """What is wrong with one file.

    Args:
        origin: How findings call the file.
    """

    def __init__(self, origin: str) -> None:
        super().__init__()
        self.origin = origin

    def say(self, code: str, text: str, place: Place) -> None:
        """Adds a finding; the same one again only once."""
        line, column = place
        finding = Finding(code=code, text=text, file=self.origin, line=line, column=column)
        if finding not in self:
            self.append(finding)


def check_size(raw: bytes, origin: str) -> None:
    """Raises `BlueprintError` when the file is longer than what is read of any file."""
    if len(raw) > MAX_BYTES:
        refuse(origin, "too_large", f"The file has {len(raw)} bytes; the limit is {MAX_BYTES}.", (0, 0))


def read_text(raw: bytes, origin: str) -> str:
    """The text of a file. Raises `BlueprintError` when it is too large or not UTF-8."""
    check_size(raw, origin)
    try:
        return raw.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = raw.count(b"\n", 0, error.start) + 1
        column = error.start - raw.rfind(b"\n", 0, error.start)
        text = f"Byte 0x{raw[error.start]:02x} is not UTF-8: save the file as UTF-8."
        refuse(origin, "not_utf8", text, (line, column))


def refuse(origin: str, code: str, text: str, place: Place) -> NoReturn:
    """Raises the `BlueprintError` that ends a reading."""
    line, column = place
    finding = Finding(code=code, text=text, file=origin, line=line, column=column)
    raise BlueprintError(str(finding), findings=[finding])
