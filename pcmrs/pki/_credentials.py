"""The files with which a process proves its identity, checked before they are used."""

from __future__ import annotations

import datetime
from collections.abc import Iterable
from pathlib import Path

from cryptography import x509
from cryptography.exceptions import InvalidSignature
from cryptography.x509.oid import NameOID

from pcmrs.bus import Credentials
from pcmrs.errors import ConfigurationError
from pcmrs.messages.identity import Identity, Role
from pcmrs.pki._authority import CERTIFICATE
from pcmrs.pki._certificates import CELL, CLOCKS_DIFFER, read_key


def read_credentials(folder: Path, now: float) -> Credentials:
    """Return the credentials in a folder that `Authority.issue` created.

    Args:
        folder: Folder with one key, the certificate of the same name, and the authority's.
        now: Wall time, Unix seconds.

    Raises:
        ConfigurationError: A file is missing or does not match the others, others may read the key, or the certificate
            is not valid yet or has expired.
    """
    path = _only_key(folder)
    name, certificate, authority = path.stem, _read(path.with_suffix(".pem")), _read(folder / CERTIFICATE)
    if read_key(path).public_key() != certificate.public_key():
        raise _wrong(folder, f"{name}.key does not belong to {name}.pem")
    try:
        certificate.verify_directly_issued_by(authority)
    except (ValueError, TypeError, InvalidSignature):
        raise _wrong(folder, f"{name}.pem was not issued by {CERTIFICATE}") from None
    if [each.value for each in certificate.subject.get_attributes_for_oid(NameOID.COMMON_NAME)] != [name]:
        raise _wrong(folder, f"{name}.pem is the certificate of another identity")
    for file, each in ((f"{name}.pem", certificate), (CERTIFICATE, authority)):
        _check_time(folder / file, each, now)
    return Credentials(
        name=name,
        cells=_cells(certificate),
        certificate=str(path.with_suffix(".pem").absolute()),
        key=str(path.absolute()),
        authority=str((folder / CERTIFICATE).absolute()),
        ends=certificate.not_valid_after_utc.timestamp(),
    )


def check_registered(credentials: Credentials, members: Iterable[Identity], role: Role, cell: str = "") -> None:
    """Require that the register has the identity of this process: without it, its rights are unknown.

    Args:
        credentials: Credentials of the process.
        members: Identities in the register.
        role: Role of the process.
        cell: Cell that it serves, ``<site>/<cell>``; empty for a router.

    Raises:
        ConfigurationError: The register lacks the identity, has revoked it, or has it with another role or for other
            cells.
    """
    found = next((each for each in members if each.name == credentials.name), None)
    wrong = None
    if found is None:
        wrong = "is not in the register: copy the authority's present one"
    elif found.revoked is not None:
        wrong = "is revoked: have a new identity issued"
    elif found.role != role:
        wrong = f"has the role {found.role}, not {role}: have one issued with that role"
    elif cell and not found.in_cell(cell):
        wrong = f"may serve {' '.join(found.cells)}, not {cell}: have one issued for this cell"
    if wrong is not None:
        raise ConfigurationError(f"{credentials.name} {wrong}.", name=credentials.name, role=role, cell=cell)


def _only_key(folder: Path) -> Path:
    keys = sorted(folder.glob("*.key"))
    if len(keys) != 1:
        raise _wrong(folder, f"it holds {len(keys)} files that end in .key, not one")
    return keys[0]


def _read(path: Path) -> x509.Certificate:
    try:
        return x509.load_pem_x509_certificate(path.read_bytes())
    except (OSError, ValueError) as error:
        raise _wrong(path.parent, f"{path.name} cannot be read: {error}") from None


def _check_time(path: Path, certificate: x509.Certificate, now: float) -> None:
    begins, ends = certificate.not_valid_before_utc.timestamp(), certificate.not_valid_after_utc.timestamp()
    if now >= ends:
        text = f"{path} has expired on {_utc(ends)}: have a new one issued, `pcmrs pki issue`, or set the clock."
        raise ConfigurationError(text, file=str(path), ended=ends, now=now)
    if now < begins - CLOCKS_DIFFER:
        text = f"{path} is valid from {_utc(begins)}, and the time here is {_utc(now)}: set the clock."
        raise ConfigurationError(text, file=str(path), begins=begins, now=now)


def _cells(certificate: x509.Certificate) -> tuple[str, ...]:
    names = certificate.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
    found = names.get_values_for_type(x509.UniformResourceIdentifier)
    return tuple(each.removeprefix(CELL) for each in found if each.startswith(CELL))


def _utc(wall: float) -> str:
    return f"{datetime.datetime.fromtimestamp(wall, datetime.UTC):%Y-%m-%d %H:%M:%S} UTC"


def _wrong(folder: Path, why: str) -> ConfigurationError:
    text = f"{folder} is not an identity from `pcmrs pki issue`: {why}."
    return ConfigurationError(text, folder=str(folder))
