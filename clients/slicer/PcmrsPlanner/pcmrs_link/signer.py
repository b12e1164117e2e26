"""Signs PCMRS string commands. Copy this file: it needs nothing but Python 3.7 or newer.

    signer = Signer("planner", read_key("planner.key"))
    sock.sendto(signer.sign(b"get_jnt_angsxxxx_#1;"), (host, 8057))

Sign a command anew each time that it is sent, also when it is sent again: the daemon takes every counter once.
"""

from __future__ import annotations

import hashlib
import hmac
import re
import time
from collections.abc import Callable
from pathlib import Path

OPENING = b"|;"
"""Send this first on a TCP connection whose commands are signed."""


def read_key(path: str) -> bytes:
    """Reads a key file that `pcmrs peers new` has made: 64 hex digits."""
    return bytes.fromhex(Path(path).read_text(encoding="ascii").strip())


class Signer:
    """Signs the commands of one peer.

    Args:
        peer: Its name in the daemon's configuration.
        key: Its key, 32 bytes.
        counter: Gives a number that grows; nanoseconds since 1970 unless given.
    """

    def __init__(self, peer: str, key: bytes, counter: Callable[[], int] = time.time_ns) -> None:
        if not re.fullmatch("[A-Za-z0-9_-]{1,32}", peer):
            raise ValueError(f"a peer's name has 1 to 32 letters, digits, '-' and '_', not {peer!r}")
        if len(key) != 32:
            raise ValueError(f"a key has 32 bytes, not {len(key)}")
        self._peer = peer.encode("ascii")
        self._key = key
        self._counter = counter
        self._last = 0

    def sign(self, command: bytes) -> bytes:
        """The datagram of a command, which ends with ``;``."""
        self._last = max(self._last + 1, self._counter())
        covered = b"%s|%s|%d" % (command, self._peer, self._last)
        tag = hmac.new(self._key, covered, hashlib.sha256).hexdigest()[:32]
        return covered + b"|" + tag.encode("ascii")

    def frame(self, command: bytes) -> bytes:
        """The same for a TCP connection that began with `OPENING`."""
        return self.sign(command) + b";"
