"""Rows of the journal and their hashes."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from typing import Annotated, Any, Final, Literal

import msgspec

from pcmrs.errors import JournalError
from pcmrs.messages import BlueprintTag, Message, Verdict
from pcmrs.messages.identity import Role

Kind = Literal["intent", "outcome", "event", "device", "snapshot", "config"]
"""Kind of a row."""

Wall = Annotated[float, msgspec.Meta(ge=0.0, lt=2.5e11)]
"""Unix seconds until the year 9892, so that every reader can convert them into a date."""

GENESIS: Final = bytes(32)
"""Previous hash of the first row."""


@dataclass(frozen=True, slots=True)
class RowPosition:
    """Position in the chain: sequence and hash of a row."""

    sequence: int
    hash: bytes


START: Final = RowPosition(0, GENESIS)
"""Position before the first row."""


class JournalRow(Message, frozen=True, kw_only=True):
    """One row, before it has its sequence and hash.

    Attributes:
        kind: ``intent`` before an operation's first step, ``outcome`` with its verdict, ``device`` for a report of
            a device, ``event`` for an action of the daemon itself, ``snapshot``, ``config``.
        command_id: Id of the command, unique per source for intents, and for outcomes.
        source: Sender and link, such as ``udp:planner:127.0.0.1``.
        user: Identity of the sender; None in rows of versions without identities.
        role: Role of the sender; None likewise.
        states: State of each branch afterwards.
        result: Results of steps that later decisions depend on.
        parent: Id of the command whose step submitted this one.
        wall: Unix seconds.
        monotonic: Seconds of the cell's clock, comparable within one `boot_id` only.
        boot_id: Id of the machine's boot.
        session_id: Id of the session.
        blueprint: Workflow under which the row was decided.
    """

    kind: Kind
    wall: Wall
    monotonic: float
    boot_id: str
    session_id: str
    blueprint: BlueprintTag
    command_id: str | None = None
    source: str | None = None
    user: str | None = None
    role: Role | None = None
    branch: str | None = None
    operation: str | None = None
    arguments: dict[str, Any] | None = None
    verdict: Verdict | None = None
    states: dict[str, str] | None = None
    result: dict[str, Any] | None = None
    parent: str | None = None


_NO_DATA: Final = (TypeError, ValueError, OverflowError, RecursionError)
"""Errors of encoding a value that is not plain data."""


class StoredRow(Message, frozen=True, kw_only=True, omit_defaults=False):
    """A row of the journal; `sequence` starts at 1 and has no gaps."""

    sequence: int
    row: JournalRow
    previous_hash: bytes
    hash: bytes


def encode_row(row: JournalRow) -> bytes:
    """Return a row as canonical MessagePack: keys in alphabetical order at each level.

    Raises:
        JournalError: The row holds a value that is not plain data.
    """
    try:
        return msgspec.msgpack.encode(row, order="sorted")
    except _NO_DATA as error:
        raise JournalError(
            f"The {row.kind} of {row.branch}.{row.operation} cannot be journalled: {error}. "
            "Use numbers, text, lists and maps only."
        ) from error


def decode_row(body: bytes) -> JournalRow:
    """Return the row that `encode_row` encoded.

    Raises:
        JournalError: The bytes are not such a row.
    """
    try:
        row = msgspec.msgpack.decode(body, type=JournalRow, ext_hook=_refuse)
        # MessagePack can hold more than plain data, such as keys that are not text: exports and reports cannot.
        msgspec.msgpack.encode(row, order="sorted")
        return row
    except (msgspec.DecodeError, UnicodeDecodeError, *_NO_DATA) as error:
        raise JournalError(f"A row of the journal is damaged: {error}. Keep the file and look at it.") from error


def _refuse(code: int, _: memoryview) -> object:
    raise ValueError(f"extension {code} of MessagePack is not plain data")


def chain_hash(previous: bytes, sequence: int, body: bytes) -> bytes:
    """Return the SHA-256 of the previous hash, the sequence (8 bytes, big-endian) and the encoded row.

    Args:
        previous: Hash of the row before, 32 bytes.
        sequence: Sequence of the row.
        body: Encoded row.
    """
    return hashlib.sha256(previous + sequence.to_bytes(8, "big") + body).digest()
