"""Certificates say who, where and for how long; keys are on P-256, and only their owner can read them."""

from __future__ import annotations

from pathlib import Path

import pytest
from cryptography import x509
from cryptography.hazmat.primitives import serialization
from cryptography.hazmat.primitives.asymmetric.ec import SECP384R1, EllipticCurvePrivateKey, generate_private_key
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from cryptography.x509.oid import ExtendedKeyUsageOID

from pcmrs.errors import ConfigurationError
from pcmrs.messages.identity import EVERY_CELL, Identity
from pcmrs.pki import Authority
from pcmrs.pki._certificates import authority_certificate, certificate, key_bytes, new_key, read_key


def test_keys_are_their_owners_alone(authority: Authority, tmp_path: Path, now: float) -> None:
    authority.issue("viewer", "vera", now, cells=EVERY_CELL, into=tmp_path)
    for key in (tmp_path / "vera" / "vera.key", authority.folder / "ca.key"):
        assert key.stat().st_mode & 0o777 == 0o600
        read_key(key)
        key.chmod(0o640)
        with pytest.raises(ConfigurationError, match=r"mode 0640.*The limit is 0600: chmod 600"):
            read_key(key)
    with pytest.raises(ConfigurationError, match="others than its owner"):
        authority.issue("viewer", "vito", now, cells=EVERY_CELL, into=tmp_path)
    assert [each.name for each in authority.identities()] == ["vera"]
    with pytest.raises(ConfigurationError, match="cannot be read"):
        read_key(tmp_path / "nothing.key")


@pytest.mark.parametrize("other", [Ed25519PrivateKey.generate(), generate_private_key(SECP384R1())], ids=["Ed", "P384"])
def test_a_key_of_another_kind_signs_no_certificate(
    authority: Authority, tmp_path: Path, now: float, other: Ed25519PrivateKey | EllipticCurvePrivateKey
) -> None:
    key = authority.folder / "ca.key"
    key.write_bytes(
        other.private_bytes(serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, serialization.NoEncryption())
    )
    with pytest.raises(ConfigurationError, match=r"ca\.key is not a key on P-256"):
        read_key(key)
    with pytest.raises(ConfigurationError, match="P-256"):
        authority.issue("viewer", "vito", now, cells=EVERY_CELL, into=tmp_path)
    assert authority.identities() == []


DAY = 86400.0
ANNA = Identity(
    name="anna", role="operator", serial="1f", begins=1.8e9, ends=1.8e9 + 7 * DAY, cells=("lab/c1", "lab/c2")
)


def issued(hosts: tuple[str, ...] = ()) -> tuple[x509.Certificate, x509.Certificate]:
    """The authority's certificate, and that of anna."""
    key, own = new_key(), new_key()
    authority = authority_certificate(key, "lab", 1.8e9)
    return authority, certificate(ANNA, own.public_key(), hosts, authority, key)


def test_a_certificate_says_who_where_and_for_how_long() -> None:
    authority, found = issued()
    found.verify_directly_issued_by(authority)
    assert found.subject.rfc4514_string() == "CN=anna"
    assert found.serial_number == 0x1F
    assert (found.not_valid_before_utc.timestamp(), found.not_valid_after_utc.timestamp()) == (ANNA.begins, ANNA.ends)
    names = found.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
    assert names.get_values_for_type(x509.UniformResourceIdentifier) == ["pcmrs:lab/c1", "pcmrs:lab/c2"]
    assert names.get_values_for_type(x509.DNSName) == ["anna"]


@pytest.mark.parametrize("hosts", [(), ("gate.lab", "10.0.0.1", "fd00::1")])
def test_only_who_is_dialled_may_serve(hosts: tuple[str, ...]) -> None:
    _, found = issued(hosts)
    uses = set(found.extensions.get_extension_for_class(x509.ExtendedKeyUsage).value)
    assert ExtendedKeyUsageOID.CLIENT_AUTH in uses
    assert (ExtendedKeyUsageOID.SERVER_AUTH in uses) == bool(hosts)
    names = found.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
    if hosts:
        assert names.get_values_for_type(x509.DNSName) == ["gate.lab"]
        assert [str(each) for each in names.get_values_for_type(x509.IPAddress)] == ["10.0.0.1", "fd00::1"]


def test_only_the_authority_may_sign_certificates() -> None:
    authority, found = issued()
    for each, signs in ((authority, True), (found, False)):
        assert each.extensions.get_extension_for_class(x509.BasicConstraints).value.ca == signs
        usage = each.extensions.get_extension_for_class(x509.KeyUsage).value
        assert (usage.key_cert_sign, usage.crl_sign, usage.digital_signature) == (signs, signs, not signs)
    assert authority.extensions.get_extension_for_class(x509.BasicConstraints).value.path_length == 0
    assert authority.subject == authority.issuer == found.issuer
    assert "lab" in authority.subject.rfc4514_string()


def test_a_key_is_read_as_it_was_written(tmp_path: Path) -> None:
    key, file = new_key(), tmp_path / "anna.key"
    file.touch(mode=0o600)
    file.write_bytes(key_bytes(key))
    assert read_key(file).private_numbers() == key.private_numbers()
    file.write_text("no key")
    with pytest.raises(ConfigurationError, match="is not a private key"):
        read_key(file)
