"""Files that anybody may have written: never more of them than a limit, and as text or refused."""

from __future__ import annotations

from pathlib import Path

from pcmrs.fsm.finding import refuse

MAX_BYTES = 256 * 1024


def read_bounded(path: Path) -> bytes:
    """The bytes of a file; of a huge one no more than shows that it is too large.

    Raises:
        OSError: It cannot be read.
    """
    with path.open("rb") as stream:
        return stream.read(MAX_BYTES + 1)


def check_size(raw: bytes, origin: str) -> None:
    """Raise `BlueprintError` when a file is longer than what is read of any file; `findings` says so."""
    if len(raw) > MAX_BYTES:
        refuse(origin, "too_large", f"The file has {len(raw)} bytes; the limit is {MAX_BYTES}. Split the workflow.")


def text_of(raw: bytes, origin: str) -> str:
    """The text of a file. Raises `BlueprintError` when it is too large or not UTF-8; `findings` has where."""
    check_size(raw, origin)
    try:
        return raw.decode()
    except UnicodeDecodeError as error:
        before = raw[: error.start].decode()
        place = before.count("\n") + 1, len(before.rpartition("\n")[2]) + 1
        text = f"Byte 0x{raw[error.start]:02x} is not UTF-8: save the file as UTF-8."
        refuse(origin, "not_utf8", text, place)
