"""The seal of what daemon and device nodes send each other, so that nobody else on the machine can speak for them.

Everybody on loopback may put and answer on any key. Daemon and nodes therefore share a key that is never sent, and each
of their messages carries a MAC over its sender's session, its number, its key and its payload. The MAC travels in the
attachment of the Zenoh message, so that those who only watch read the payload as before.

The MAC is HMAC-SHA256 (RFC 2104), cut to 16 bytes as section 5 of that RFC permits. Each number is taken once, within a
window, as in section 3.4.3 of RFC 4303: messages of different priorities overtake each other.
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
"""Length of a key."""

WINDOW: Final = 4096
"""A message is refused when its sender has sealed more messages than this after it: some seconds of all streams."""

SESSIONS: Final = 64
"""Senders that are remembered; each of them has had the key."""

_HEXADECIMAL: Final = re.compile(rf"[0-9a-f]{{{2 * KEY_BYTES}}}")

Kind = Literal["put", "query", "reply", "error"]
_KINDS: Final[dict[Kind, int]] = {"put": 1, "query": 2, "reply": 3, "error": 4}
_HEAD: Final = struct.Struct("<B8sQ")
_MAC: Final = 16
LENGTH: Final = _HEAD.size + _MAC
"""Bytes of a seal."""


def new_key() -> bytes:
    """Return a random key."""
    return secrets.token_bytes(KEY_BYTES)


def read_key(path: Path) -> bytes:
    """Return the key in a file, as `write_key` has written it.

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
        ConfigurationError: There is a file of that name.
        OSError: It cannot be written.
    """
    if path.exists():
        raise ConfigurationError(f"{path} is there already: choose another name, or delete it.", file=str(path))
    write_durably(path, new_key().hex().encode() + b"\n", mode=SECRET)


def is_sealed(key: str) -> bool:
    """Whether messages on a relative key are sealed: those between daemon and device nodes.

    A scene exists in simulations only, and is where tests inject faults from outside.
    """
    first, _, rest = key.partition("/")
    if first == "dev":
        return rest.partition("/")[0] != "scene"
    return first == "daemon" or key == "state/joints" or key.startswith("state/pose/")


class Seal:
    """Seals messages, and checks the seals of others. From any thread.

    Args:
        key: Shared by daemon and nodes; `KEY_BYTES` bytes.
    """

    def __init__(self, key: bytes) -> None:
        self._key = key
        self._session = secrets.token_bytes(8)
        self._numbers = itertools.count(1)

    def put(self, kind: Kind, key: str, payload: bytes, query: bytes = b"") -> bytes:
        """Return the seal of a message.

        Args:
            kind: Of message.
            key: Absolute key.
            payload: As it is sent.
            query: The seal of the query that a reply answers.
        """
        head = _HEAD.pack(_KINDS[kind], self._session, next(self._numbers))
        return head + self._mac(head, key, payload, query)

    def check(
        self, seal: bytes, kinds: tuple[Kind, ...], key: str, payload: bytes, taken: Taken, query: bytes = b""
    ) -> Kind:
        """Check that a message was sealed with the key, for this use, and comes for the first time.

        Args:
            seal: Of the message.
            kinds: Permitted here.
            key: Absolute key on which it came.
            payload: As it came.
            taken: What this receiver has taken before; the message is added.
            query: The seal of the query that a reply must answer.

        Returns:
            The kind of message.

        Raises:
            SealError: It has no seal (``unsealed``) or a wrong one (``forged``), or came before (``repeated``).
        """
        if len(seal) != LENGTH:
            raise SealError(f"{key}: the message is not sealed, so daemon and nodes do not take it.", why="unsealed")
        head = seal[: _HEAD.size]
        number_of_kind, session, number = _HEAD.unpack(head)
        kind = next((each for each in kinds if _KINDS[each] == number_of_kind), None)
        if kind is None or not hmac.compare_digest(seal[_HEAD.size :], self._mac(head, key, payload, query)):
            raise SealError(f"{key}: the message was not sealed with the key of this cell's daemon.", why="forged")
        if not taken.take(session, number):
            text = f"{key}: message {number} came before, or more than {WINDOW} messages late."
            raise SealError(text, why="repeated")
        return kind

    def _mac(self, head: bytes, key: str, payload: bytes, query: bytes) -> bytes:
        name = key.encode()
        lengths = struct.pack("<HB", len(name), len(query))
        return hmac.digest(self._key, b"".join((head, lengths, name, query, payload)), "sha256")[:_MAC]


class Taken:
    """Which messages one receiver has taken, by sender. From any thread.

    Each receiver has its own: two of one process that hear the same key both take each message once.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._senders: dict[bytes, _Numbers] = {}

    def take(self, session: bytes, number: int) -> bool:
        """Take a message, unless it was taken before or is too late."""
        with self._lock:
            numbers = self._senders.setdefault(session, _Numbers())
            while len(self._senders) > SESSIONS:
                del self._senders[next(iter(self._senders))]
            return numbers.take(number)


class _Numbers:
    """Which numbers of one sender were taken."""

    __slots__ = ("_bits", "_newest")

    def __init__(self) -> None:
        self._newest = 0
        self._bits = 0  # bit i: `_newest` - i was taken

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
