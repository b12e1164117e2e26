"""Signs PCMRS string commands, and checks the answers. Copy this file: it needs nothing but Python 3.7 or newer.

    signer = Signer("planner", read_key("planner.key"), answers_signed=True)
    sock.sendto(signer.sign(b"get_jnt_angsxxxx_#1;"), (host, 8057))
    answer = signer.check(sock.recv(1024))

Sign a command each time that it is sent, also when it is repeated: the daemon accepts each counter once.
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
    """Read a key file that `pcmrs peers new` has made: 64 hex digits."""
    return bytes.fromhex(Path(path).read_text(encoding="ascii").strip())


_ANSWER = re.compile(rb"(([ -:<-~]*;)\|([A-Za-z0-9_-]{1,32})\|([1-9][0-9]{0,18}))\|([0-9a-f]{32})")


class Signer:
    """Signer of the commands of one peer, and verifier of the answers to them.

    Args:
        peer: Its name in the daemon's configuration.
        key: Its key, 32 bytes.
        counter: Gives a number that grows; nanoseconds since 1970 unless given.
        answers_signed: Whether an answer without a signature is refused. The daemon signs its answers to peers with
            ``counter = "unix_ns"`` in its configuration, and to no others.
    """

    def __init__(
        self, peer: str, key: bytes, counter: Callable[[], int] = time.time_ns, answers_signed: bool = False
    ) -> None:
        if not re.fullmatch("[A-Za-z0-9_-]{1,32}", peer):
            raise ValueError(f"a peer's name has 1 to 32 letters, digits, '-' and '_', not {peer!r}")
        if len(key) != 32:
            raise ValueError(f"a key has 32 bytes, not {len(key)}")
        self._peer = peer.encode("ascii")
        self._key = key
        self._counter = counter
        self._answers_signed = answers_signed
        self._first = self._last = 0

    def sign(self, command: bytes) -> bytes:
        """The datagram of a command, which ends with ``;``."""
        self._last = max(self._last + 1, self._counter())
        self._first = self._first or self._last
        covered = b"%s|%s|%d" % (command, self._peer, self._last)
        return covered + b"|" + self._tag(covered)

    def frame(self, command: bytes) -> bytes:
        """The same for a TCP connection that began with `OPENING`."""
        return self.sign(command) + b";"

    def check(self, answer: bytes) -> bytes:
        """An answer without its signature; over TCP, of a frame without the ``;`` at its end.

        Raises:
            ValueError: The daemon did not sign it for this peer, or it answers no command that this has signed.
        """
        match = _ANSWER.fullmatch(answer)
        if match is None:
            if self._answers_signed or b"|" in answer:
                raise ValueError(f"{answer[:60]!r} is no signed answer")
            return answer
        ours = match[3] == self._peer and 0 < self._first <= int(match[4]) <= self._last
        # The zero byte is in no command, so none can be sent back as an answer.
        if not (ours and hmac.compare_digest(match[5], self._tag(b"\0" + match[1]))):
            raise ValueError(f"{answer[:60]!r} is no answer to this client, or its signature does not hold")
        return match[2]

    def _tag(self, covered: bytes) -> bytes:
        return hmac.new(self._key, covered, hashlib.sha256).hexdigest()[:32].encode("ascii")
