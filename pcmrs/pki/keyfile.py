"""Private keys in files that nobody but their owner can read."""

from __future__ import annotations

from pathlib import Path

from cryptography.hazmat.primitives import serialization
from cryptography.hazmat.primitives.asymmetric.ec import SECP256R1, EllipticCurvePrivateKey, generate_private_key

from pcmrs.errors import ConfigurationError
from pcmrs.files import read_secret


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
    try:
        key = serialization.load_pem_private_key(read_secret(path), None)
    except OSError as error:
        raise ConfigurationError(f"The key {path} cannot be read: {error.strerror}.", path=str(path)) from None
    except (ValueError, TypeError) as error:
        raise ConfigurationError(f"{path} is not a private key: {error}.", path=str(path)) from None
    if not (isinstance(key, EllipticCurvePrivateKey) and isinstance(key.curve, SECP256R1)):
        raise ConfigurationError(f"{path} is not a key on P-256.", path=str(path))
    return key
