"""Private keys in files that nobody but their owner can read."""

from __future__ import annotations

from pathlib import Path

from cryptography.hazmat.primitives import serialization
from cryptography.hazmat.primitives.asymmetric.ec import SECP256R1, EllipticCurvePrivateKey, generate_private_key

from pcmrs.errors import ConfigurationError

OTHERS = 0o077


def check_private(path: Path) -> None:
    """Refuses a secret that others may read, or that is not there.

    Raises:
        ConfigurationError: Its mode gives group or others anything, or it cannot be looked at.
    """
    try:
        mode = path.stat().st_mode
    except OSError as error:
        raise ConfigurationError(f"The key {path} cannot be read: {error.strerror}.", path=str(path)) from None
    if mode & OTHERS:
        text = (
            f"The key {path} may be read by others (mode {mode & 0o777:04o}, the limit is 0600): `chmod 600 {path}`, "
            "and issue a new one if somebody may have copied it."
        )
        raise ConfigurationError(text, path=str(path), mode=f"{mode & 0o777:04o}", limit="0600")


def new_key() -> EllipticCurvePrivateKey:
    """A key on P-256, which every TLS library knows."""
    return generate_private_key(SECP256R1())


def key_bytes(key: EllipticCurvePrivateKey) -> bytes:
    """The key in PEM, PKCS 8, not encrypted: the mode of its file protects it."""
    return key.private_bytes(
        serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, serialization.NoEncryption()
    )


def read_key(path: Path) -> EllipticCurvePrivateKey:
    """Reads a private key.

    Raises:
        ConfigurationError: Others may read it, it is missing, or it is no such key.
    """
    check_private(path)
    try:
        key = serialization.load_pem_private_key(path.read_bytes(), None)
    except (OSError, ValueError, TypeError) as error:
        raise ConfigurationError(f"{path} is not a private key: {error}.", path=str(path)) from None
    if not isinstance(key, EllipticCurvePrivateKey):
        raise ConfigurationError(f"{path} is not a key on P-256.", path=str(path))
    return key
