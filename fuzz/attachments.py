"""Attachments of messages: signatures of people and seals of nodes; without the key none is accepted.

python -m fuzz.attachments -max_total_time=60
"""

from __future__ import annotations

import struct
import tempfile
from pathlib import Path

from cryptography import x509
from cryptography.hazmat.primitives.serialization import Encoding

from fuzz.running import instrumented, run

with instrumented("pcmrs.bus.seal", "pcmrs.bus.signature"):
    from pcmrs.bus.seal import KEY_BYTES, ReplayWindow, Seal
    from pcmrs.bus.settings import BusSettings
    from pcmrs.bus.signature import SignatureVerifier
    from pcmrs.clock import SystemClock
    from pcmrs.errors import SealError
    from pcmrs.messages.identity import EVERY_CELL
    from pcmrs.pki import Authority, read_credentials, read_register

FOLDER = tempfile.TemporaryDirectory(prefix="fuzz-attachments-")
NOW = SystemClock().wall()
KEY, PAYLOAD = "pcmrs/lab/c1/cmd/tom/robot/connect", b"{}"
HEAD = struct.Struct("<BQH")
"""Head of a signature: kind of message, time of sending in ns, length of the certificate."""


class StandingClock(SystemClock):
    """A clock that stands a second after the certificates were issued: no input is old."""

    def wall(self) -> float:
        return NOW + 1.0


def make_verifier(folder: Path) -> tuple[SignatureVerifier, bytes]:
    """Return the verifier of a daemon, and the certificate of an operator whose messages a router may carry.

    Args:
        folder: Folder for the authority and the identities.
    """
    authority = Authority.init(folder / "pki", "lab", NOW)
    authority.issue("router", "gate", NOW, hosts=("127.0.0.1",), cells=EVERY_CELL, into=folder)
    authority.issue("daemon", "c1", NOW, hosts=("127.0.0.1",), cells=EVERY_CELL, into=folder)
    authority.issue("operator", "tom", NOW, via=("gate",), cells=EVERY_CELL, into=folder)
    settings = BusSettings(
        cell="c1",
        credentials=read_credentials(folder / "c1", NOW),
        members=tuple(read_register(authority.folder / "register.json")),
    )
    certificate = x509.load_pem_x509_certificate((folder / "tom" / "tom.pem").read_bytes())
    return SignatureVerifier(settings, StandingClock()), certificate.public_bytes(Encoding.DER)


VERIFIER, CERTIFICATE = make_verifier(Path(FOLDER.name))
SEAL, WINDOW = Seal(bytes(KEY_BYTES)), ReplayWindow()


def one(data: bytes) -> None:
    """Check an attachment; the first byte selects a seal, a signature, or one with a certificate of the input.

    The certificate is the rest of the input, or the operator's, with some bytes replaced by the input.
    """
    kind, rest = data[:1], data[1:]
    if kind < b"\x40":
        check_seal(rest)
    elif kind < b"\x80":
        check_signature(rest)
    elif kind < b"\xc0":
        check_signature(signature_with(rest[:0xFFFF]))
    else:
        place = int.from_bytes(rest[:2]) % len(CERTIFICATE)
        altered = CERTIFICATE[:place] + rest[2:] + CERTIFICATE[place + len(rest[2:]) :]
        check_signature(signature_with(altered[:0xFFFF]))


def check_seal(seal: bytes) -> None:
    """Check that a seal is refused."""
    try:
        SEAL.check(seal, ("put", "query"), KEY, PAYLOAD, WINDOW)
    except SealError as error:
        assert error.fields["why"] in ("unsealed", "forged")  # noqa: PT017  # not a test
        return
    raise AssertionError("A seal without the key was accepted.")


def check_signature(signature: bytes) -> None:
    """Check that a signature is refused."""
    objection = VERIFIER.objection(signature, "put", "tom", KEY, PAYLOAD)
    assert objection is not None, "A signature without the key was accepted."
    assert objection.fields["why"] in ("unsigned", "forged", "certificate", "old", "ahead")


def signature_with(certificate: bytes) -> bytes:
    """Return a fresh signature with this certificate, and no valid tag."""
    return HEAD.pack(1, int(NOW * 1e9), len(certificate)) + certificate + bytes(70)


if __name__ == "__main__":
    run(one)
