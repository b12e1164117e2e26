"""Signature of the messages that people send, so that no router on the way can forge them.

A router ends TLS on both sides, so the daemon cannot tell which certificate a message came with. Anyone who connects
with a certificate therefore signs commands and set points with the key of that certificate. The daemon accepts only
signed ones from members whose register entry names a router (`Identity.via`). Stop is never signed.

The signature is in the attachment of the Zenoh message: kind of message, time, certificate, and ECDSA with SHA-256
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
"""Greatest difference between the sender's time stamp and our clock at which a message is accepted, s."""
REMEMBERED: Final = 4096
"""Number of time stamps that are remembered for each member; a message that is older than all of them is refused."""

Kind = Literal["put", "query"]
_KINDS: Final[dict[Kind, int]] = {"put": 1, "query": 2}
_HEAD: Final = struct.Struct("<BQH")
_PURPOSE: Final = b"pcmrs bus message 1\0"
"""Prefix of all signed bytes: the same key signs TLS handshakes, and neither signature may pass for the other."""
_STEP: Final = 1_000_000
"""Greatest step of a coarse clock: messages within it may read the same time, ns."""


class CertificateSigner:
    """Signer of messages with the key of a certificate. From any thread.

    Args:
        certificate: Certificate of the sender.
        key: Private key of the certificate.
        clock: Clock of the machine.
    """

    def __init__(self, certificate: x509.Certificate, key: EllipticCurvePrivateKey, clock: Clock) -> None:
        self._certificate = certificate.public_bytes(Encoding.DER)
        self._key = key
        self._clock = clock
        self._lock = threading.Lock()
        self._last = 0

    @classmethod
    def read(cls, own: Credentials, clock: Clock) -> CertificateSigner:
        """Read certificate and key.

        Args:
            own: Identity of this process.
            clock: Clock of the machine.

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
            kind: Kind of message.
            key: Absolute key.
            payload: Payload as it is sent.
        """
        head = _HEAD.pack(_KINDS[kind], self._stamp(), len(self._certificate)) + self._certificate
        return head + self._key.sign(_signed(head, key, payload), ECDSA(SHA256()))

    def _stamp(self) -> int:
        """Return a time stamp, ns: never the same twice; follows the clock when it is set."""
        now = int(self._clock.wall() * 1e9)
        with self._lock:
            self._last = self._last + 1 if 0 <= self._last - now < _STEP else now
            return self._last


class SignatureVerifier:
    """Verifier for the messages of members whose messages may pass a router. From any thread.

    Args:
        settings: Settings of the daemon: its register, its cell, and the certificate of its authority.
        clock: Clock of the machine.

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
        # Messages that were accepted before a restart are not remembered; this time keeps them from being replayed.
        self._started_at = int(clock.wall() * 1e9)
        self._lock = threading.Lock()
        self._members: dict[str, _Member] = {}

    def objection(self, signature: bytes, kind: Kind, user: str, key: str, payload: bytes) -> AccessError | None:
        """Return why a message is rejected; None for a valid one, which is then accepted only once.

        The error's ``why`` is the reason why the user may not take part in this cell or, for a user who has to sign: no
        signature (``unsigned``), a wrong one (``forged``), one by an invalid ``certificate``, or a time stamp that is
        ``old``, ``ahead`` or ``repeated``.

        Args:
            signature: Signature of the message; empty for none.
            kind: Kind of message.
            user: User in whose name the message was sent.
            key: Absolute key on which it arrived.
            payload: Payload as it arrived.
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
                f"Messages of {user!r} must be signed, because the register allows them to pass a router: use a client "
                "of this version with the identity, not a bare Zenoh client."
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
            text = f"A message of {user!r} arrived before, or was sent before the daemon restarted: send a new one."
            raise AccessError(text, user=user, why="repeated")

    def _key_of(self, member: Identity, certificate: bytes, now: float) -> EllipticCurvePublicKey:
        """Return the public key of a member; each certificate is verified once."""
        with self._lock:
            known = self._members.get(member.name)
        if known is not None and known.certificate == certificate:
            return known.key
        key = self._verified(member, certificate, now)
        with self._lock:
            self._members.setdefault(member.name, _Member(certificate, key, self._started_at))
        return key

    def _verified(self, member: Identity, certificate: bytes, now: float) -> EllipticCurvePublicKey:
        """Return the public key of a certificate if its serial is that of the member's entry. Raises `AccessError`."""
        try:
            found = x509.load_der_x509_certificate(certificate)
            found.verify_directly_issued_by(self._authority)
            key = found.public_key()
        except (ValueError, TypeError, x509.InvalidVersion, UnsupportedAlgorithm, InvalidSignature):
            raise _wrong_certificate(member.name, "was not issued by the authority of this lab") from None
        if found.serial_number != int(member.serial, 16) or not isinstance(key, EllipticCurvePublicKey):
            raise _wrong_certificate(member.name, "is not the one in the register")
        if not found.not_valid_before_utc.timestamp() <= now < found.not_valid_after_utc.timestamp():
            raise _wrong_certificate(member.name, "is not valid now")
        return key


class _Member:
    """One member's certificate, and the time stamps of the accepted messages.

    Args:
        certificate: Verified certificate, DER.
        key: Public key of the certificate.
        floor: Messages up to this time stamp are rejected, ns.
    """

    __slots__ = ("_floor", "_taken", "certificate", "key")

    def __init__(self, certificate: bytes, key: EllipticCurvePublicKey, floor: int) -> None:
        self.certificate = certificate
        self.key = key
        self._floor = floor
        self._taken: list[int] = []

    def take(self, stamp: int) -> bool:
        """Accept a message; return False if it was accepted before or is older than all that are remembered."""
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
            "the clock of that machine is behind that of the daemon. Set both clocks, by NTP for example."
        )
        raise AccessError(text, user=user, why="old", age=age, limit=FRESH_FOR)
    if age < -FRESH_FOR:
        text = (
            f"The clock of {user!r} is {-age:.1f} s ahead of that of the daemon, the limit is {FRESH_FOR:g} s. Set "
            "both clocks, by NTP for example."
        )
        raise AccessError(text, user=user, why="ahead", ahead=-age, limit=FRESH_FOR)


def _forged(user: str) -> AccessError:
    text = (
        f"The signature of a message of {user!r} is not valid: the message was changed on its way, or somebody else "
        "sent it. Unless its operator knows why, stop using that router."
    )
    return AccessError(text, user=user, why="forged")


def _wrong_certificate(user: str, fault: str) -> AccessError:
    text = (
        f"The certificate with which a message of {user!r} was signed {fault}: use the newest identity, and give this "
        "daemon the current register of the authority."
    )
    return AccessError(text, user=user, why="certificate")
