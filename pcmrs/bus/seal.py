"""Seal of the messages between daemon and device nodes, so that no other process on the machine can forge them.

Every process on loopback may put and answer on any key. Daemon and nodes therefore share a key that is never sent, and
each of their messages carries a MAC over its sender's session, its number, its key and its payload. The MAC is in the
attachment of the Zenoh message, so that observers can read the payload without the key.

The MAC is HMAC-SHA256 (RFC 2104), cut to 16 bytes as section 5 of that RFC permits. Each number is accepted once,
within a window, as in section 3.4.3 of RFC 4303, because messages of different priorities overtake each other.
"""

from __future__ import annotations

import hmac
import itertools
import re
import secrets
import struct
import threading
from pathlib import Path
from typing import Final, Literal

from pcmrs.errors import ConfigurationError, SealError
from pcmrs.files import SECRET, read_secret, write_durably

KEY_BYTES: Final = 32
"""Length of a key, bytes."""

WINDOW: Final = 4096
"""Width of the replay window, messages of one sender: some seconds of all streams. An older message is rejected."""

SESSIONS: Final = 64
"""Number of senders that are remembered; only processes that have the key become senders."""

_HEXADECIMAL: Final = re.compile(rf"[0-9a-f]{{{2 * KEY_BYTES}}}")

Kind = Literal["put", "query", "reply", "error"]
_KINDS: Final[dict[Kind, int]] = {"put": 1, "query": 2, "reply": 3, "error": 4}
_HEAD: Final = struct.Struct("<B8sQ")
_MAC: Final = 16
LENGTH: Final = _HEAD.size + _MAC
"""Length of a seal, bytes."""


def new_key() -> bytes:
    """Return a random key."""
    return secrets.token_bytes(KEY_BYTES)


def read_key(path: Path) -> bytes:
    """Return the key in a file that `write_key` has written.

    Raises:
        ConfigurationError: The file cannot be read, is open to others than its owner, or holds no key.
    """
    try:
        text = read_secret(path).decode("ascii", "replace").strip()
    except OSError as error:
        raise ConfigurationError(f"{path} cannot be read: {error.strerror}.", file=str(path)) from None
    if not _HEXADECIMAL.fullmatch(text):
        raise ConfigurationError(
            f"{path} holds no key: {2 * KEY_BYTES} hexadecimal digits are needed. Make one: pcmrs pki device-key FILE.",
            file=str(path),
        )
    return bytes.fromhex(text)


def write_key(path: Path) -> None:
    """Write a new key into a new file that only its owner may read.

    Raises:
        ConfigurationError: The file exists already.
        OSError: The file cannot be written.
    """
    if path.exists():
        raise ConfigurationError(f"{path} exists already: choose another name, or delete it.", file=str(path))
    write_durably(path, new_key().hex().encode() + b"\n", mode=SECRET)


def is_sealed(key: str) -> bool:
    """Return True for a relative key whose messages are sealed: those between daemon and device nodes.

    The scene is not sealed: it exists in simulations only, and tests inject faults there from outside.
    """
    first, _, rest = key.partition("/")
    if first == "dev":
        return rest.partition("/")[0] != "scene"
    return first == "daemon" or key == "state/joints" or key.startswith("state/pose/")


class Seal:
    """Seals messages, and checks seals. From any thread.

    Args:
        key: Key that daemon and nodes share; `KEY_BYTES` bytes.
    """

    def __init__(self, key: bytes) -> None:
        self._key = key
        self._session = secrets.token_bytes(8)
        self._numbers = itertools.count(1)

    def put(self, kind: Kind, key: str, payload: bytes, query: bytes = b"") -> bytes:
        """Return the seal of a new message.

        Args:
            kind: Kind of message.
            key: Absolute key.
            payload: Payload as it is sent.
            query: Seal of the query that a reply answers; empty otherwise.
        """
        head = _HEAD.pack(_KINDS[kind], self._session, next(self._numbers))
        return head + self._mac(head, key, payload, query)

    def check(
        self, seal: bytes, kinds: tuple[Kind, ...], key: str, payload: bytes, taken: ReplayWindow, query: bytes = b""
    ) -> Kind:
        """Check that a message was sealed with the key, for this use, and arrives for the first time.

        Args:
            seal: Seal of the message.
            kinds: Kinds of message that are permitted here.
            key: Absolute key on which the message arrived.
            payload: Payload as it arrived.
            taken: Messages that this receiver has accepted before; this one is added.
            query: Seal of the query that a reply must answer; empty otherwise.

        Returns:
            The kind of message.

        Raises:
            SealError: The message has no seal (``unsealed``) or a wrong one (``forged``), or is a repetition
                (``repeated``).
        """
        if len(seal) != LENGTH:
            raise SealError(f"{key}: the message is not sealed; daemon and nodes reject it.", why="unsealed")
        head = seal[: _HEAD.size]
        number_of_kind, session, number = _HEAD.unpack(head)
        kind = next((each for each in kinds if _KINDS[each] == number_of_kind), None)
        if kind is None or not hmac.compare_digest(seal[_HEAD.size :], self._mac(head, key, payload, query)):
            raise SealError(f"{key}: the message was not sealed with the key of this cell's daemon.", why="forged")
        if not taken.take(session, number):
            text = f"{key}: message {number} arrived before, or more than {WINDOW} messages late."
            raise SealError(text, why="repeated")
        return kind

    def _mac(self, head: bytes, key: str, payload: bytes, query: bytes) -> bytes:
        name = key.encode()
        lengths = struct.pack("<HB", len(name), len(query))
        return hmac.digest(self._key, b"".join((head, lengths, name, query, payload)), "sha256")[:_MAC]


class ReplayWindow:
    """Anti-replay window of one receiver: the messages that it has accepted, by sender. From any thread.

    Each receiver has its own, because two subscribers of one process on the same key both accept each message once.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._senders: dict[bytes, _NumberWindow] = {}

    def take(self, session: bytes, number: int) -> bool:
        """Accept a message.

        Args:
            session: Random session id of the sender, 8 bytes.
            number: Number of the message in that session, from 1.

        Returns:
            False if it was accepted before or is older than the window.
        """
        with self._lock:
            numbers = self._senders.setdefault(session, _NumberWindow())
            while len(self._senders) > SESSIONS:
                del self._senders[next(iter(self._senders))]
            return numbers.take(number)


class _NumberWindow:
    """Numbers of one sender that were accepted."""

    __slots__ = ("_bits", "_newest")

    def __init__(self) -> None:
        self._newest = 0
        self._bits = 0  # bit i: `_newest` - i was accepted

    def take(self, number: int) -> bool:
        if number > self._newest:
            ahead = number - self._newest
            self._bits = 1 if ahead >= WINDOW else (self._bits << ahead | 1) & ((1 << WINDOW) - 1)
            self._newest = number
            return True
        bit = 1 << (self._newest - number) if self._newest - number < WINDOW else 0
        if not bit or self._bits & bit:
            return False
        self._bits |= bit
        return True
