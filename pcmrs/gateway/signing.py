"""Signatures of command datagrams: key files, what is signed, how it is read, and a client's own signatures.

A signed datagram is ``<command>;|<peer>|<counter>|<tag>``: the peer's name, a decimal counter that grows with every
datagram of that peer, and the first 32 hex digits, in lower case, of HMAC-SHA256 over everything before the last
``|``. Whether a signature holds is not decided here.

A signed answer is ``<answer>;|<peer>|<counter>|<tag>`` with the counter of the command that it answers. Its tag is made
of a zero byte and everything before the last ``|``: no command holds that byte, so none can be sent back as an answer,
nor an answer as a command.
"""

from __future__ import annotations

import hashlib
import hmac
import os
import re
import secrets
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from pcmrs.errors import ConfigurationError, PayloadError
from pcmrs.files import SECRET, read_secret

_HEX = re.compile(r"[0-9a-fA-F]{64}\n?")


def new_key(path: Path) -> None:
    """Write a new random key; an existing file is not changed.

    Raises:
        ConfigurationError: The file exists.
        OSError: The file cannot be written.
    """
    try:
        descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, SECRET)
    except FileExistsError:
        raise ConfigurationError(
            f"{path} exists, and the holder of this key would be locked out. Remove it first, or choose another name.",
            file=str(path),
        ) from None
    with os.fdopen(descriptor, "w", encoding="ascii") as file:
        file.write(secrets.token_bytes(KEY_BYTES).hex() + "\n")
        file.flush()
        os.fsync(descriptor)


def read_key(path: Path) -> bytes:
    """Read a key.

    Raises:
        ConfigurationError: The file cannot be read, others than its owner may use it, or it holds no key.
    """
    try:
        content = read_secret(path)
    except OSError as error:
        text = f"The key {path} cannot be read ({error.strerror}); make one with: pcmrs peers new NAME."
        raise ConfigurationError(text, file=str(path)) from None
    text = content.decode("ascii", "replace")
    if not _HEX.fullmatch(text):
        # The message does not show the content of the file: it may be most of a key.
        raise ConfigurationError(
            f"{path} holds no key: {2 * KEY_BYTES} hex digits. Make one with: pcmrs peers new NAME.", file=str(path)
        )
    return bytes.fromhex(text)


KEY_BYTES = 32
PEER_NAME = re.compile(r"[A-Za-z0-9_-]{1,32}")

_TAG_DIGITS = 32
_SIGNED = re.compile(rb"(([\x20-\x3a\x3c-\x7e]{0,255};)\|([A-Za-z0-9_-]{1,32})\|([1-9][0-9]{0,18}))\|([0-9a-f]{32})")
"""A command of at most 256 bytes with its signature, of at most 86."""
_ANSWER = re.compile(rb"(([\x20-\x3a\x3c-\x7e]*;)\|([A-Za-z0-9_-]{1,32})\|([1-9][0-9]{0,18}))\|([0-9a-f]{32})")
_OF_ANSWERS = b"\0"


@dataclass(frozen=True, slots=True)
class Signed:
    """A signed datagram in its parts.

    Attributes:
        command: The command with its terminator.
        peer: Name of the sender as the datagram gives it.
        counter: Larger than in any datagram that the peer sent before.
        covered: Bytes that the tag covers.
        tag: 32 hex digits.
    """

    command: bytes
    peer: str
    counter: int
    covered: bytes
    tag: bytes

    def holds(self, key: bytes) -> bool:
        """Return whether the tag was made with this key; takes the same time for every tag."""
        return hmac.compare_digest(self.tag, tag_of(self.covered, key))


def split(datagram: bytes) -> Signed | None:
    """Return the parts of a signed datagram; None for one without a well-formed signature."""
    match = _SIGNED.fullmatch(datagram)
    if match is None:
        return None
    return Signed(match[2], match[3].decode("ascii"), int(match[4]), match[1], match[5])


def tag_of(covered: bytes, key: bytes) -> bytes:
    """Return the tag of some bytes.

    Args:
        covered: The bytes.
        key: The peer's key, 32 bytes.
    """
    return hmac.new(key, covered, hashlib.sha256).hexdigest()[:_TAG_DIGITS].encode("ascii")


def sign_answer(answer: str, peer: str, counter: int, key: bytes) -> str:
    """Return an answer with its signature.

    Args:
        answer: The answer; it is ended by ``;`` if it is not.
        peer: Name of the receiver.
        counter: Counter of the command that it answers.
        key: The peer's key, 32 bytes.
    """
    covered = f"{answer.removesuffix(';')};|{peer}|{counter}"
    return f"{covered}|{tag_of(_OF_ANSWERS + covered.encode('ascii'), key).decode('ascii')}"


class Signer:
    """Signer of the commands of one peer, and verifier of the answers to them.

    Counters are nanoseconds since 1970 unless given, so that they grow across restarts of the client without a file.

    Args:
        peer: The peer's name in the daemon's configuration.
        key: Its key, 32 bytes.
        counter: Returns a number; if it has not grown, the next greater one is used.
        answers_signed: Refuse an answer without a signature. The daemon signs its answers to peers with
            ``counter = "unix_ns"``, and to no others.

    Raises:
        PayloadError: The name or the length of the key is not valid.
    """

    def __init__(
        self, peer: str, key: bytes, counter: Callable[[], int] = time.time_ns, *, answers_signed: bool = False
    ) -> None:
        if not PEER_NAME.fullmatch(peer):
            raise PayloadError(f"{peer!r} is not a name of a peer: 1 to 32 letters, digits, '-' and '_'.", peer=peer)
        if len(key) != KEY_BYTES:
            raise PayloadError(f"The key has {len(key)} bytes; it must have {KEY_BYTES}.", size=len(key))
        self._peer = peer
        self._key = key
        self._counter = counter
        self._answers_signed = answers_signed
        self._first = self._last = 0

    def sign(self, command: bytes) -> bytes:
        """Return the signed datagram of a command, with a new counter each time, also for a repeated command."""
        self._last = max(self._last + 1, self._counter())
        self._first = self._first or self._last
        covered = b"%s|%s|%d" % (command, self._peer.encode("ascii"), self._last)
        return covered + b"|" + tag_of(covered, self._key)

    def check(self, answer: bytes) -> bytes:
        """Return an answer without its signature.

        An answer to a command of an earlier run is refused. Within a run the command's id tells which one is answered.

        Raises:
            PayloadError: The daemon did not sign it for this peer, or it answers no command of this signer.
        """
        match = _ANSWER.fullmatch(answer)
        if match is None:
            if self._answers_signed or b"|" in answer:
                raise PayloadError(f"{answer[:60]!r} is not a signed answer.")
            return answer
        tag = tag_of(_OF_ANSWERS + match[1], self._key)
        ours = match[3] == self._peer.encode("ascii") and 0 < self._first <= int(match[4]) <= self._last
        if not (ours and hmac.compare_digest(match[5], tag)):
            raise PayloadError(f"{answer[:60]!r} is not an answer to {self._peer!r}, or its signature is wrong.")
        return match[2]
