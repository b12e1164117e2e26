"""Signatures of command datagrams: what is signed, how it is read, and a client's own signatures.

A signed datagram is ``<command>;|<peer>|<counter>|<tag>``: the peer's name, a decimal counter that grows with every
datagram of that peer, and the first 32 hex digits, in lower case, of HMAC-SHA256 over everything before the last
``|``. Whether a signature holds is not decided here.
"""

from __future__ import annotations

import hashlib
import hmac
import re
import time
from collections.abc import Callable
from dataclasses import dataclass

from pcmrs.errors import PayloadError

KEY_BYTES = 32
PEER_NAME = re.compile(r"[A-Za-z0-9_-]{1,32}")

_TAG_DIGITS = 32
_SIGNED = re.compile(rb"(([\x20-\x3a\x3c-\x7e]{0,255};)\|([A-Za-z0-9_-]{1,32})\|([1-9][0-9]{0,18}))\|([0-9a-f]{32})")
"""A command of at most 256 bytes with its signature, of at most 86."""


@dataclass(frozen=True, slots=True)
class Signed:
    """A signed datagram in its parts.

    Attributes:
        command: The command with its terminator.
        peer: Who is said to have sent it.
        counter: Larger than in any datagram that the peer sent before.
        covered: What the tag is made of.
        tag: 32 hex digits.
    """

    command: bytes
    peer: str
    counter: int
    covered: bytes
    tag: bytes

    def holds(self, key: bytes) -> bool:
        """Whether the tag was made with this key; takes as long whatever the tag is."""
        return hmac.compare_digest(self.tag, tag_of(self.covered, key))


def split(datagram: bytes) -> Signed | None:
    """The parts of a signed datagram; None for one that has no signature, or what only looks like one."""
    match = _SIGNED.fullmatch(datagram)
    if match is None:
        return None
    return Signed(match[2], match[3].decode("ascii"), int(match[4]), match[1], match[5])


def tag_of(covered: bytes, key: bytes) -> bytes:
    """The tag of what it covers."""
    return hmac.new(key, covered, hashlib.sha256).hexdigest()[:_TAG_DIGITS].encode("ascii")


class Signer:
    """Signs the commands of one peer.

    Counters are nanoseconds since 1970 unless given, so that they grow across restarts of the client without a file.

    Args:
        peer: The peer's name in the daemon's configuration.
        key: Its key, 32 bytes.
        counter: Gives a number; the next one where it has not grown.

    Raises:
        PayloadError: The name or the length of the key cannot be one.
    """

    def __init__(self, peer: str, key: bytes, counter: Callable[[], int] = time.time_ns) -> None:
        if not PEER_NAME.fullmatch(peer):
            raise PayloadError(f"{peer!r} is no name of a peer: 1 to 32 letters, digits, '-' and '_'.", peer=peer)
        if len(key) != KEY_BYTES:
            raise PayloadError(f"The key has {len(key)} bytes; it must have {KEY_BYTES}.", size=len(key))
        self._peer = peer
        self._key = key
        self._counter = counter
        self._last = 0

    def sign(self, command: bytes) -> bytes:
        """The signed datagram of a command; each time with a new counter, also for a command sent again."""
        self._last = max(self._last + 1, self._counter())
        covered = b"%s|%s|%d" % (command, self._peer.encode("ascii"), self._last)
        return covered + b"|" + tag_of(covered, self._key)
