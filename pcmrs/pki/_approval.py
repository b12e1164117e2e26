"""Approval of a drafted workflow: a person's signature over the hash of its blueprint, in a file beside it.

The key is that of the person's identity. The daemon accepts an approval only from a member of its register.
"""

from __future__ import annotations

import base64
import binascii
import hashlib
from collections.abc import Iterable
from pathlib import Path
from typing import Final

import msgspec
from cryptography import x509
from cryptography.exceptions import InvalidSignature
from cryptography.hazmat.primitives.asymmetric.ec import ECDSA, EllipticCurvePublicKey
from cryptography.hazmat.primitives.hashes import SHA256

from pcmrs.bus import Credentials
from pcmrs.errors import ConfigurationError
from pcmrs.fsm import Blueprint
from pcmrs.messages.identity import Identity, Role
from pcmrs.pki._certificates import read_key

APPROVING: tuple[Role, ...] = ("operator",)
"""Roles whose approval a daemon accepts: those who command the robot."""
LARGEST: Final = 64 * 1024
"""Limit of the file, bytes."""
_PURPOSE: Final = b"pcmrs approval of a workflow 1\0"
"""Prefix of the signed bytes: the same key signs messages and TLS handshakes, and none may pass for the other."""


class Approval(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """One approval.

    Attributes:
        id: Name of the workflow.
        version: Its version.
        hash: Hash of its blueprint.
        migrations: SHA-256 of its migrations, hexadecimal: the blueprint's hash does not cover them.
        by: Name of the person.
        at: Wall time, Unix seconds.
        certificate: Certificate of the person, PEM.
        signature: ECDSA with SHA-256 over all the others, base64.
    """

    id: str
    version: str
    hash: str
    migrations: str
    by: str
    at: float
    certificate: str
    signature: str = ""


def approval_file(blueprint: Path) -> Path:
    """Return the file of the approval of a blueprint: ``NAME.approval.json`` beside ``NAME.toml``."""
    return blueprint.with_suffix(".approval.json")


def approve(blueprint: Blueprint, own: Credentials, now: float) -> Approval:
    """Sign a workflow with a person's key.

    Args:
        blueprint: The workflow.
        own: Identity of the person.
        now: Wall time, Unix seconds.

    Raises:
        ConfigurationError: The key cannot be read.
        OSError: The certificate cannot be read.
    """
    approval = Approval(
        id=blueprint.id,
        version=blueprint.version,
        hash=blueprint.hash,
        migrations=_hash_of_migrations(blueprint),
        by=own.name,
        at=now,
        certificate=Path(own.certificate).read_text(encoding="ascii"),
    )
    signature = read_key(Path(own.key)).sign(_signed(approval), ECDSA(SHA256()))
    return msgspec.structs.replace(approval, signature=base64.b64encode(signature).decode())


def read_approval(
    blueprint: Blueprint, file: Path, own: Credentials | None, members: Iterable[Identity], cell: str, now: float
) -> Approval | None:
    """Return the valid approval of a drafted workflow; None for a workflow that people have written.

    Args:
        blueprint: The workflow.
        file: File of its blueprint.
        own: Identity of the daemon, which has the certificate of the authority; None for none.
        members: Members in the daemon's register.
        cell: Cell that is to run it, ``<site>/<cell>``.
        now: Wall time, s: a person whose identity has ended approves nothing any more.

    Raises:
        ConfigurationError: There is no approval, it is of another content, or its signature is not one of a member who
            may approve in this cell.
    """
    if blueprint.provenance is msgspec.UNSET:
        return None
    if own is None:
        why = "this cell has no identity and register by which it could know the person: set access.identity"
        raise _refused(blueprint, file, why)
    approval = _read(blueprint, file)
    if (approval.hash, approval.migrations) != (blueprint.hash, _hash_of_migrations(blueprint)):
        raise _refused(blueprint, file, "it was changed after it was approved")
    member = next((each for each in members if each.name == approval.by), None)
    if member is None or not member.valid(now) or member.role not in APPROVING or not member.in_cell(cell):
        why = f"{approval.by} is not in the register as a valid {' or '.join(APPROVING)} of {cell}"
        raise _refused(blueprint, file, why)
    certificate = _signing_certificate(approval, own)
    if certificate is None:
        raise _refused(blueprint, file, f"the signature of the approval is not that of {approval.by}")
    if f"{certificate.serial_number:x}" != member.serial:
        why = f"{approval.by} signed with an older certificate, whose key may be in other hands"
        raise _refused(blueprint, file, why)
    return approval


def _read(blueprint: Blueprint, file: Path) -> Approval:
    try:
        with approval_file(file).open("rb") as stream:
            return msgspec.json.decode(stream.read(LARGEST), type=Approval)
    except FileNotFoundError:
        raise _refused(blueprint, file, "nobody has approved it") from None
    except (OSError, msgspec.DecodeError) as error:
        raise _refused(blueprint, file, f"{approval_file(file)} cannot be read: {error}") from None


def _hash_of_migrations(blueprint: Blueprint) -> str:
    return hashlib.sha256(msgspec.json.encode(blueprint.migrations)).hexdigest()


def _signing_certificate(approval: Approval, own: Credentials) -> x509.Certificate | None:
    """Return the certificate whose key has signed; None if it is not the person's, not of this lab, or had ended."""
    try:
        authority = x509.load_pem_x509_certificate(Path(own.authority).read_bytes())
        certificate = x509.load_pem_x509_certificate(approval.certificate.encode())
        certificate.verify_directly_issued_by(authority)
        signature, key = base64.b64decode(approval.signature, validate=True), certificate.public_key()
        if not isinstance(key, EllipticCurvePublicKey):
            return None
        key.verify(signature, _signed(approval), ECDSA(SHA256()))
    except (OSError, ValueError, TypeError, binascii.Error, InvalidSignature):
        return None
    names = [each.value for each in certificate.subject.get_attributes_for_oid(x509.NameOID.COMMON_NAME)]
    begins, ends = certificate.not_valid_before_utc.timestamp(), certificate.not_valid_after_utc.timestamp()
    return certificate if names == [approval.by] and begins <= approval.at < ends else None


def _signed(approval: Approval) -> bytes:
    return _PURPOSE + msgspec.json.encode(msgspec.structs.replace(approval, signature=""), order="sorted")


def _refused(blueprint: Blueprint, file: Path, why: str) -> ConfigurationError:
    text = f"{file}: a language model has drafted {blueprint.id}, and it cannot be started: {why}. "
    text += f"A person reviews it, then signs it with `pcmrs fsm approve {file}`."
    return ConfigurationError(text, file=str(file), hash=blueprint.hash)
