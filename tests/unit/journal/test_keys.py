"""The key pair of a journal: lost, replaced or mismatched keys are named, and no new pair takes their place."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
from cryptography.hazmat.primitives.asymmetric.ec import SECP256R1, generate_private_key
from cryptography.hazmat.primitives.serialization import Encoding, NoEncryption, PrivateFormat, PublicFormat

from pcmrs.errors import JournalError
from pcmrs.journal import Journal, verify
from pcmrs.journal.writer import JournalWriter
from pcmrs.testing.journal import HEAD, NAME

_P256 = generate_private_key(SECP256R1())


OTHER_KIND = (
    _P256.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption()),
    _P256.public_key().public_bytes(Encoding.PEM, PublicFormat.SubjectPublicKeyInfo),
)
"""A private key and its public one, as PEM, of a kind that signs no head."""


def test_only_its_owner_may_read_the_key(path: Path) -> None:
    JournalWriter(path, durable=True).close()
    assert path.with_name("journal.key").stat().st_mode & 0o777 == 0o600


@pytest.mark.parametrize(
    ("spoil", "word"),
    [
        (lambda folder: (folder / HEAD).unlink(), "head is missing"),
        (lambda folder: (folder / HEAD).write_bytes(bytes(8192)), "damaged, or signed with another key"),
        (lambda folder: (folder / "journal.key").unlink(), "journal.key is missing"),
        (lambda folder: (folder / "journal.key").chmod(0o644), "others than its owner may use this key"),
        (lambda folder: (folder / "journal.key").write_text("no key"), "not a private key"),
        (lambda folder: (folder / "journal.pub").write_text("no key"), "not the public key"),
        (lambda folder: (folder / "journal.key").write_bytes(OTHER_KIND[0]), r"journal\.key is not an Ed25519 key"),
        (lambda folder: (folder / "journal.pub").write_bytes(OTHER_KIND[1]), r"journal\.pub is not an Ed25519 key"),
    ],
)
def test_without_its_head_or_key_nothing_is_written(
    killed_path: Path, spoil: Callable[[Path], object], word: str
) -> None:
    spoil(killed_path.parent)
    with pytest.raises(JournalError, match=word):
        Journal.open(killed_path)


def test_a_link_to_a_missing_key_is_named_and_stays(tmp_path: Path) -> None:
    """The disk with the key is not mounted: no new key takes its place."""
    key = tmp_path / "journal.key"
    key.symlink_to("/nowhere/journal.key")
    with pytest.raises(JournalError, match=r"journal\.key, a symbolic link to /nowhere/journal\.key, is missing"):
        Journal.open(tmp_path / NAME)
    assert key.is_symlink()


def test_a_public_key_of_another_kind_verifies_nothing(killed_path: Path, tmp_path: Path) -> None:
    other = tmp_path / "other.pub"
    other.write_bytes(OTHER_KIND[1])
    with pytest.raises(JournalError, match=r"other\.pub is not an Ed25519 key"):
        verify(killed_path, public=other)


@pytest.mark.parametrize("lost", [("journal.key",), ("journal.key", "journal.pub")])
def test_a_lost_key_is_not_replaced(killed_path: Path, lost: tuple[str, ...]) -> None:
    for name in lost:
        killed_path.with_name(name).unlink()
    with pytest.raises(JournalError, match=r"journal\.key is missing, .*put it back from a copy"):
        Journal.open(killed_path)
    assert not any(killed_path.with_name(name).exists() for name in lost)


async def test_replaced_key_pair_is_detected(killed_path: Path, tmp_path: Path) -> None:
    (tmp_path / "other").mkdir()
    await Journal.open(tmp_path / "other" / NAME).close()
    for name in ("journal.key", "journal.pub"):
        (killed_path.parent / name).write_bytes((tmp_path / "other" / name).read_bytes())
    with pytest.raises(JournalError, match="another key"):
        Journal.open(killed_path)
    assert verify(killed_path).signature == "does not hold"
    (killed_path.parent / HEAD).write_bytes((tmp_path / "other" / NAME).with_name(HEAD).read_bytes())
    assert not verify(killed_path, public=tmp_path / "whole" / "journal.pub").sound


@pytest.mark.parametrize("replaced", ["journal.key", "journal.pub"])
async def test_mismatched_keys_are_detected(killed_path: Path, tmp_path: Path, replaced: str) -> None:
    (tmp_path / "other").mkdir()
    await Journal.open(tmp_path / "other" / NAME).close()
    killed_path.with_name(replaced).write_bytes((tmp_path / "other" / replaced).read_bytes())
    with pytest.raises(JournalError, match=r"journal\.pub does not belong to journal\.key beside it"):
        Journal.open(killed_path)
