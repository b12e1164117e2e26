"""The signature of what a person sends, so that no router on the way can speak in that person's name.

A router ends the TLS on both sides, so the daemon cannot see from a message which certificate has let it in. Anyone who
dials with a certificate therefore signs commands and set points with the key of that certificate, and the daemon takes
nothing without it from those whom the register marks with a router (`Identity.via`). Stop is never signed.

The signature travels in the attachment of the Zenoh message: kind of message, time, certificate, and ECDSA with SHA-256
(FIPS 186-5) over these, the absolute key and the payload.
"""

from __future__ import annotations

import struct
import threading
from bisect import bisect_left
from pathlib import Path
from typing import Final, Literal

from cryptography import x509
from cryptography.exceptions import InvalidSignature, UnsupportedAlgorithm
from cryptography.hazmat.primitives.asymmetric.ec import (
    ECDSA,
    SECP256R1,
    EllipticCurvePrivateKey,
    EllipticCurvePublicKey,
)
from cryptography.hazmat.primitives.hashes import SHA256
from cryptography.hazmat.primitives.serialization import Encoding, load_pem_private_key

from pcmrs.bus.settings import BusSettings, Credentials
from pcmrs.clock import Clock
from pcmrs.errors import AccessError, ConfigurationError
from pcmrs.files import read_secret
from pcmrs.messages.identity import LOCAL, Identity

FRESH_FOR: Final = 2.0
"""Seconds between the clock of the sender and ours at which a message is still taken: its way included."""
REMEMBERED: Final = 4096
"""Times of messages that are remembered for each member; what is older than all of them is refused."""

Kind = Literal["put", "query"]
_KINDS: Final[dict[Kind, int]] = {"put": 1, "query": 2}
_HEAD: Final = struct.Struct("<BQH")
_PURPOSE: Final = b"pcmrs bus message 1\0"
"""Begins all that is signed: the same key signs handshakes of TLS, and neither may pass for the other."""
_STEP: Final = 1_000_000
"""Times of two messages that are less apart may be the same on a coarse clock, ns."""


class Signer:
    """Signs messages with the key of a certificate. From any thread.

    Args:
        certificate: Of the sender.
        key: Of the certificate.
        clock: The machine's clock.
    """

    def __init__(self, certificate: x509.Certificate, key: EllipticCurvePrivateKey, clock: Clock) -> None:
        self._certificate = certificate.public_bytes(Encoding.DER)
        self._key = key
        self._clock = clock
        self._lock = threading.Lock()
        self._last = 0

    @classmethod
    def read(cls, own: Credentials, clock: Clock) -> Signer:
        """Read certificate and key.

        Raises:
            ConfigurationError: A file cannot be read, or the key is of another kind.
        """
        try:
            key = load_pem_private_key(read_secret(Path(own.key)), None)
            certificate = x509.load_pem_x509_certificate(Path(own.certificate).read_bytes())
        except (OSError, ValueError, TypeError) as error:
            text = f"{own.certificate} and its key cannot be read: {error}. Have them issued again."
            raise ConfigurationError(text, certificate=own.certificate, key=own.key) from None
        if not (isinstance(key, EllipticCurvePrivateKey) and isinstance(key.curve, SECP256R1)):
            raise ConfigurationError(f"{own.key} is not a key on P-256. Have it issued again.", key=own.key)
        return cls(certificate, key, clock)

    def sign(self, kind: Kind, key: str, payload: bytes) -> bytes:
        """Return the signature of a message that is sent now.

        Args:
            kind: Of message.
            key: Absolute key.
            payload: As it is sent.
        """
        head = _HEAD.pack(_KINDS[kind], self._stamp(), len(self._certificate)) + self._certificate
        return head + self._key.sign(_signed(head, key, payload), ECDSA(SHA256()))

    def _stamp(self) -> int:
        """The time, ns: never the same twice, and after the clock was set, its new one."""
        now = int(self._clock.wall() * 1e9)
        with self._lock:
            self._last = self._last + 1 if 0 <= self._last - now < _STEP else now
            return self._last


class Signatures:
    """Checks the messages of members who may come through a router. From any thread.

    Args:
        settings: Of the daemon: its register, its cell, and the certificate of its authority.
        clock: The machine's clock.

    Raises:
        ConfigurationError: The certificate of the authority cannot be read.
    """

    def __init__(self, settings: BusSettings, clock: Clock) -> None:
        assert settings.credentials is not None
        path = Path(settings.credentials.authority)
        try:
            self._authority = x509.load_pem_x509_certificate(path.read_bytes())
        except (OSError, ValueError) as error:
            raise ConfigurationError(f"{path} cannot be read: {error}.", file=str(path)) from None
        self._settings = settings
        self._clock = clock
        # What was taken before a restart is not remembered, and not taken again.
        self._begun = int(clock.wall() * 1e9)
        self._lock = threading.Lock()
        self._members: dict[str, _Member] = {}

    def objection(self, signature: bytes, kind: Kind, user: str, key: str, payload: bytes) -> AccessError | None:
        """Return why a message may not be taken as a user's; None where it may, and is taken from now on.

        The error's ``why`` is that of a user who may not take part in this cell, or, for one who has to sign: no
        signature (``unsigned``), a wrong one (``forged``), one by a ``certificate`` that does not count, or a time that
        is ``old``, ``ahead`` or ``repeated``.

        Args:
            signature: Of the message; empty for none.
            kind: Of message.
            user: In whose name it comes.
            key: Absolute key on which it came.
            payload: As it came.
        """
        try:
            self._take(signature, kind, user, key, payload)
        except AccessError as error:
            return error
        return None

    def _take(self, signature: bytes, kind: Kind, user: str, key: str, payload: bytes) -> None:
        if user == LOCAL:
            return
        now = self._clock.wall()
        member = self._settings.member(user, now)
        if not member.via:
            return
        if not signature:
            text = (
                f"What {user!r} sends has to be signed, since the register says that it may come through a router: use "
                "a client of this version with the identity, not a bare Zenoh client."
            )
            raise AccessError(text, user=user, why="unsigned")
        number, stamp, length = _HEAD.unpack_from(signature) if len(signature) > _HEAD.size else (0, 0, 0)
        if number != _KINDS[kind]:
            raise _forged(user)
        _check_age(user, now - stamp * 1e-9)
        end = _HEAD.size + length
        public = self._key_of(member, signature[_HEAD.size : end], now)
        try:
            public.verify(signature[end:], _signed(signature[:end], key, payload), ECDSA(SHA256()))
        except InvalidSignature:
            raise _forged(user) from None
        with self._lock:
            taken = self._members[user].take(stamp)
        if not taken:
            text = f"A message of {user!r} came before, or the daemon was restarted after it was sent: send a new one."
            raise AccessError(text, user=user, why="repeated")

    def _key_of(self, member: Identity, certificate: bytes, now: float) -> EllipticCurvePublicKey:
        """The public key of a member, whose certificate is verified once."""
        with self._lock:
            known = self._members.get(member.name)
        if known is not None and known.certificate == certificate:
            return known.key
        key = self._verified(member, certificate, now)
        with self._lock:
            self._members.setdefault(member.name, _Member(certificate, key, self._begun))
        return key

    def _verified(self, member: Identity, certificate: bytes, now: float) -> EllipticCurvePublicKey:
        """The key of a certificate that is the member's in the register, by its serial. Raises `AccessError`."""
        try:
            found = x509.load_der_x509_certificate(certificate)
            found.verify_directly_issued_by(self._authority)
            key = found.public_key()
        except (ValueError, TypeError, x509.InvalidVersion, UnsupportedAlgorithm, InvalidSignature):
            raise _not_counted(member.name, "was not issued by the authority of this lab") from None
        if found.serial_number != int(member.serial, 16) or not isinstance(key, EllipticCurvePublicKey):
            raise _not_counted(member.name, "is not the one in the register")
        if not found.not_valid_before_utc.timestamp() <= now < found.not_valid_after_utc.timestamp():
            raise _not_counted(member.name, "does not count now")
        return key


class _Member:
    """One member's certificate, and the times of the messages that were taken.

    Args:
        certificate: As it was verified; the register has one for each member.
        key: Its public key.
        floor: What is not later is not taken, ns.
    """

    __slots__ = ("_floor", "_taken", "certificate", "key")

    def __init__(self, certificate: bytes, key: EllipticCurvePublicKey, floor: int) -> None:
        self.certificate = certificate
        self.key = key
        self._floor = floor
        self._taken: list[int] = []

    def take(self, stamp: int) -> bool:
        """Take a message, unless it was taken before or is older than all that are remembered."""
        place = bisect_left(self._taken, stamp)
        if stamp <= self._floor or self._taken[place : place + 1] == [stamp]:
            return False
        self._taken.insert(place, stamp)
        if len(self._taken) > REMEMBERED:
            self._floor = self._taken.pop(0)
        return True


def _signed(head: bytes, key: str, payload: bytes) -> bytes:
    name = key.encode()
    return b"".join((_PURPOSE, head, struct.pack("<H", len(name)), name, payload))


def _check_age(user: str, age: float) -> None:
    if age > FRESH_FOR:
        text = (
            f"A message of {user!r} is {age:.1f} s old, the limit is {FRESH_FOR:g} s: it was held back on its way, or "
            "the clock of that machine is behind ours. Set both clocks, by NTP for example."
        )
        raise AccessError(text, user=user, why="old", age=age, limit=FRESH_FOR)
    if age < -FRESH_FOR:
        text = (
            f"The clock of {user!r} is {-age:.1f} s ahead of ours, the limit is {FRESH_FOR:g} s. Set both clocks, by "
            "NTP for example."
        )
        raise AccessError(text, user=user, why="ahead", ahead=-age, limit=FRESH_FOR)


def _forged(user: str) -> AccessError:
    text = (
        f"The signature of a message of {user!r} does not hold: it was changed on its way, or somebody else has sent "
        "it. Unless they know why, use that router no more."
    )
    return AccessError(text, user=user, why="forged")


def _not_counted(user: str, fault: str) -> AccessError:
    text = (
        f"The certificate with which a message of {user!r} was signed {fault}: use the newest identity, and give this "
        "daemon the authority's present register."
    )
    return AccessError(text, user=user, why="certificate")
