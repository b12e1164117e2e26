"""The key pair that signs the journal's head, created with the first journal of a cell's folder."""

from __future__ import annotations

from pathlib import Path
from typing import Final

from cryptography.exceptions import InternalError, InvalidSignature, UnsupportedAlgorithm
from cryptography.hazmat.primitives import serialization
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey, Ed25519PublicKey

from pcmrs.errors import ConfigurationError, JournalError
from pcmrs.files import SECRET, read_secret, write_durably

PRIVATE: Final = "journal.key"
PUBLIC: Final = "journal.pub"

_NO_KEY: Final = (ValueError, TypeError, UnsupportedAlgorithm, InternalError)
"""Errors that OpenSSL raises for bytes that are not a key, depending on the damage."""


def signing_key(folder: Path, *, make: bool) -> Ed25519PrivateKey:
    """Return the private key of the journals in a folder, and write the public key beside it if it is missing.

    Args:
        folder: Folder of the journals.
        make: True to create a pair if there is none.

    Raises:
        JournalError: The private key is missing, damaged, does not match the public key, or is readable by others.
    """
    path = folder / PRIVATE
    try:
        if not path.exists():
            _refuse_to_replace(path, folder / PUBLIC, make)
            _make(path)
        key = _read_private(path)
        _publish(key.public_key(), folder / PUBLIC)
    except OSError as error:
        raise JournalError(f"{path} cannot be used: {error.strerror}.", path=str(path)) from error
    return key


def public_key(path: Path) -> Ed25519PublicKey:
    """Read a public key in PEM.

    Raises:
        JournalError: The file is missing or is not an Ed25519 key.
    """
    try:
        pem = path.read_bytes()
    except OSError as error:
        raise JournalError(f"{path} is not the public key of a journal: {error}.", path=str(path)) from error
    return parse_public_key(pem, str(path))


def parse_public_key(pem: bytes, name: str) -> Ed25519PublicKey:
    """Return the public key of a journal.

    Args:
        pem: Key in PEM.
        name: Name of the key for the message, such as its path.

    Raises:
        JournalError: The bytes are not an Ed25519 key.
    """
    try:
        key = serialization.load_pem_public_key(pem)
    except _NO_KEY as error:
        raise JournalError(f"{name} is not the public key of a journal: {error}.", path=name) from error
    if not isinstance(key, Ed25519PublicKey):
        raise JournalError(f"{name} is not an Ed25519 key.", path=name)
    return key


def signed_by(key: Ed25519PublicKey, signature: bytes, message: bytes) -> bool:
    """Return whether a signature is valid.

    Args:
        key: Public key of the signer.
        signature: Signature, 64 bytes.
        message: Bytes that were signed.
    """
    try:
        key.verify(signature, message)
    except InvalidSignature:
        return False
    return True


def _refuse_to_replace(path: Path, public: Path, make: bool) -> None:
    # A dangling link is a key on a disk that is not there: a new key must not take its place.
    linked = f", a symbolic link to {path.readlink()}," if path.is_symlink() else ""
    if public.exists() or linked or not make:
        raise JournalError(
            f"{path}{linked} is missing, and journals are signed with it: put it back from a copy, or start a new "
            "journal in another cell.folder. `pcmrs journal verify` needs the public key only.",
            path=str(path),
        )


def _make(path: Path) -> None:
    private = Ed25519PrivateKey.generate().private_bytes(
        serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, serialization.NoEncryption()
    )
    write_durably(path, private, mode=SECRET)


def _read_private(path: Path) -> Ed25519PrivateKey:
    try:
        key = serialization.load_pem_private_key(read_secret(path), None)
    except ConfigurationError as error:
        raise JournalError(error.text, path=str(path)) from error
    except _NO_KEY as error:
        raise JournalError(f"{path} is not a private key: {error}. Put it back from a copy.", path=str(path)) from error
    if not isinstance(key, Ed25519PrivateKey):
        raise JournalError(f"{path} is not an Ed25519 key. Put it back from a copy.", path=str(path))
    return key


def _publish(key: Ed25519PublicKey, path: Path) -> None:
    if not path.exists():
        pem = key.public_bytes(serialization.Encoding.PEM, serialization.PublicFormat.SubjectPublicKeyInfo)
        write_durably(path, pem, mode=0o644)
    elif public_key(path) != key:
        raise JournalError(
            f"{path} does not belong to {PRIVATE} beside it: one of the two was replaced. Put the pair back from a "
            "copy, or start a new journal in another cell.folder.",
            path=str(path),
        )
