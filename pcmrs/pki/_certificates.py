"""X.509 certificates, signed by the authority's key, and private keys in files that only their owner can read."""

from __future__ import annotations

import datetime
import ipaddress
from collections.abc import Sequence
from pathlib import Path

from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric.ec import (
    SECP256R1,
    EllipticCurvePrivateKey,
    EllipticCurvePublicKey,
    generate_private_key,
)
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

from pcmrs.errors import ConfigurationError
from pcmrs.files import read_secret
from pcmrs.messages.identity import Identity


def new_key() -> EllipticCurvePrivateKey:
    """Return a new key on P-256, which every TLS library supports."""
    return generate_private_key(SECP256R1())


def key_bytes(key: EllipticCurvePrivateKey) -> bytes:
    """Return a key in PEM, PKCS 8, not encrypted: the mode of its file protects it."""
    return key.private_bytes(
        serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, serialization.NoEncryption()
    )


def read_key(path: Path) -> EllipticCurvePrivateKey:
    """Read a private key.

    Raises:
        ConfigurationError: Others may read the file, it is missing, or it is not such a key.
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


CLOCKS_DIFFER = 300.0
"""Time before its issue from which a certificate is valid, s, since the clocks of two machines differ."""
AUTHORITY_DAYS = 3650
CELL = "pcmrs:"
"""Prefix of each cell of an identity; its certificate holds them as URIs."""


def authority_certificate(key: EllipticCurvePrivateKey, site: str, now: float) -> x509.Certificate:
    """Return the self-signed certificate of an authority.

    Args:
        key: Key of the authority.
        site: Name of the lab, a part of its name.
        now: Wall time, Unix seconds.
    """
    name = _name(f"pcmrs {site} authority")
    return (
        _builder(name, name, key.public_key(), x509.random_serial_number(), now, now + AUTHORITY_DAYS * 86400.0)
        .add_extension(x509.BasicConstraints(ca=True, path_length=0), critical=True)
        .add_extension(_usage(sign=True), critical=True)
        .sign(key, hashes.SHA256())
    )


def certificate(
    identity: Identity,
    public: EllipticCurvePublicKey,
    hosts: Sequence[str],
    authority: x509.Certificate,
    key: EllipticCurvePrivateKey,
) -> x509.Certificate:
    """Return the certificate of an identity.

    Args:
        identity: Identity with name, serial and times.
        public: Public key of the identity.
        hosts: Names and addresses at which others connect to it; empty if they do not.
        authority: Certificate of the authority.
        key: Key of the authority.
    """
    # One that others connect to also connects: a daemon to its router, a router to another one.
    uses = [ExtendedKeyUsageOID.CLIENT_AUTH, *([ExtendedKeyUsageOID.SERVER_AUTH] if hosts else [])]
    builder = (
        _builder(
            _name(identity.name), authority.subject, public, int(identity.serial, 16), identity.begins, identity.ends
        )
        .add_extension(x509.BasicConstraints(ca=False, path_length=None), critical=True)
        .add_extension(_usage(sign=False), critical=True)
        .add_extension(x509.ExtendedKeyUsage(uses), critical=False)
    )
    names: list[x509.GeneralName] = [_general_name(host) for host in (hosts or (identity.name,))]
    names += [x509.UniformResourceIdentifier(CELL + each) for each in identity.cells]
    return builder.add_extension(x509.SubjectAlternativeName(names), critical=False).sign(key, hashes.SHA256())


def _builder(
    name: x509.Name, issuer: x509.Name, public: EllipticCurvePublicKey, serial: int, begins: float, ends: float
) -> x509.CertificateBuilder:
    return (
        x509.CertificateBuilder()
        .subject_name(name)
        .issuer_name(issuer)
        .public_key(public)
        .serial_number(serial)
        .not_valid_before(_time(begins))
        .not_valid_after(_time(ends))
    )


def _usage(*, sign: bool) -> x509.KeyUsage:
    return x509.KeyUsage(
        digital_signature=not sign,
        content_commitment=False,
        key_encipherment=False,
        data_encipherment=False,
        key_agreement=False,
        key_cert_sign=sign,
        crl_sign=sign,
        encipher_only=False,
        decipher_only=False,
    )


def _name(common: str) -> x509.Name:
    return x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, common)])


def _time(wall: float) -> datetime.datetime:
    return datetime.datetime.fromtimestamp(wall, datetime.UTC)


def _general_name(host: str) -> x509.GeneralName:
    try:
        return x509.IPAddress(ipaddress.ip_address(host))
    except ValueError:
        return x509.DNSName(host)
