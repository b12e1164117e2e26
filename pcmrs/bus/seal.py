"""Seal of the messages between daemon and device nodes, so that no other process on the machine can forge them.

Every process on loopback may put and answer on any key. Daemon and nodes therefore share a key that is never sent, and
each of their messages carries a MAC over its sender's session, its number, its key and its payload. The MAC is in the
attachment of the Zenoh message, so that observers can read the payload without the key.

A key in a file is the same after a restart. Each message therefore names a run of the daemon, random for each start,
and nobody accepts one of another run. All but the daemon ask it which run is the present one (`pcmrs.bus.handshake`),
and accept nothing before its answer. The answer also tells a node that has just started how far the daemon and its
heart have counted, so that nothing is accepted that was sent in this run before the node was there.

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
RUN_BYTES: Final = 8
"""Length of the name of a run of the daemon, bytes."""

WINDOW: Final = 4096
"""Width of the replay window, messages of one sender: some seconds of all streams. An older message is rejected."""

SESSIONS: Final = 64
"""Number of senders that are remembered: those whose messages were accepted last. Only processes that have the key
become senders."""

_HEXADECIMAL: Final = re.compile(rf"[0-9a-f]{{{2 * KEY_BYTES}}}")

Kind = Literal["put", "query", "reply", "error", "question"]
_KINDS: Final[dict[Kind, int]] = {"put": 1, "query": 2, "reply": 3, "error": 4, "question": 5}
_HEAD: Final = struct.Struct("<B8s8sQ")
_MAC: Final = 16
LENGTH: Final = _HEAD.size + _MAC
"""Length of a seal, bytes."""
_COUNTED: Final = struct.Struct("<8sQ")


def new_key() -> bytes:
    """Return a random key."""
    return secrets.token_bytes(KEY_BYTES)


def new_run() -> bytes:
    """Return the random name of a run of the daemon."""
    return secrets.token_bytes(RUN_BYTES)


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

    The scene is not sealed: it exists in simulations only, and tests inject faults there from outside. Poses of ROS 2
    (``ros2/tracker/*``) are not sealed either: the bridge that puts them has no key. The driver ``ros2`` uses them.
    """
    first, _, rest = key.partition("/")
    if first == "dev":
        return rest.partition("/")[0] != "scene"
    return first == "daemon" or key == "state/joints" or key.startswith("state/pose/")


class Seal:
    """Maker and checker of seals on messages. From any thread.

    Args:
        key: Key that daemon and nodes share, `KEY_BYTES` bytes. The daemon and its children have the run of the daemon
            behind it (`new_run`), so that their first messages name it.
        daemon: True for the daemon, which knows its run; all others must have it confirmed before they accept anything.
    """

    def __init__(self, key: bytes, *, daemon: bool = False) -> None:
        self._key, run = key[:KEY_BYTES], key[KEY_BYTES:]
        self._run = run or bytes(RUN_BYTES)
        self._session = secrets.token_bytes(8)
        self._numbers = itertools.count(1)
        self._lock = threading.Lock()
        self._counted: dict[bytes, int] = {}  # at the daemon: newest number of each process that speaks for it
        self._earlier: dict[bytes, int] = {}  # elsewhere: what was counted when the run was confirmed first
        self.is_daemon = daemon
        self.is_confirmed = daemon

    def count(self, seal: bytes) -> None:
        """Note at the daemon how far a process that speaks for it has counted.

        Args:
            seal: Seal of a checked message on a key of the daemon.
        """
        _, _, session, number = _HEAD.unpack(seal[: _HEAD.size])
        with self._lock:
            newest = max(number, self._counted.pop(session, 0))
            self._counted[session] = newest
            if len(self._counted) > SESSIONS:
                del self._counted[next(iter(self._counted))]

    def answer(self) -> bytes:
        """Return the daemon's answer to a question: how far each process that speaks for it has counted."""
        with self._lock:
            return b"".join(_COUNTED.pack(session, number) for session, number in self._counted.items())

    def confirm(self, seal: bytes, answer: bytes) -> None:
        """Accept messages of the daemon's present run from now on, and name it in all messages.

        A process that has been running for some time keeps what it has accepted, and messages on their way may be older
        than the answer. So only the first answer excludes what was sent before it.

        Args:
            seal: Seal of a checked answer of the daemon.
            answer: Payload of that answer.
        """
        _, run, session, number = _HEAD.unpack(seal[: _HEAD.size])
        if not self.is_confirmed:
            self._earlier = dict(_COUNTED.iter_unpack(answer)) | {session: number}
        self._run, self.is_confirmed = run, True

    def put(self, kind: Kind, key: str, payload: bytes, query: bytes = b"") -> bytes:
        """Return the seal of a new message.

        Args:
            kind: Kind of message.
            key: Absolute key.
            payload: Payload as it is sent.
            query: Seal of the query that a reply answers; empty otherwise.
        """
        head = _HEAD.pack(_KINDS[kind], self._run, self._session, next(self._numbers))
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
            SealError: The message has no seal (``unsealed``) or a wrong one (``forged``), is a repetition
                or older than this process (``repeated``), or was sealed for another run of the daemon
                (``other_run``).
        """
        if len(seal) != LENGTH:
            raise SealError(f"{key}: the message is not sealed; daemon and nodes reject it.", why="unsealed")
        head = seal[: _HEAD.size]
        number_of_kind, run, session, number = _HEAD.unpack(head)
        kind = next((each for each in kinds if _KINDS[each] == number_of_kind), None)
        if kind is None or not hmac.compare_digest(seal[_HEAD.size :], self._mac(head, key, payload, query)):
            raise SealError(f"{key}: the message was not sealed with the key of this cell's daemon.", why="forged")
        # A reply is bound to its query, and the sender of a question does not know the run yet.
        if not query and kind != "question" and not (self.is_confirmed and run == self._run):
            text = f"{key}: the message is of another run of the daemon, or the daemon has not confirmed its run yet."
            raise SealError(text, why="other_run")
        if (not query and number <= self._earlier.get(session, 0)) or not taken.take(session, number):
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
            numbers = self._senders.get(session) or _NumberWindow()
            if not numbers.take(number):
                return False
            self._senders.pop(session, None)
            self._senders[session] = numbers  # at the end: a sender that is still received is not forgotten
            if len(self._senders) > SESSIONS:
                del self._senders[next(iter(self._senders))]
            return True


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
