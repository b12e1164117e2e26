"""The signed head: what is lost, set back, forged or taken away is said, with how many rows and what to do."""

from __future__ import annotations

import gzip
import sqlite3
from collections.abc import Callable
from pathlib import Path

import pytest
from cryptography.hazmat.primitives.asymmetric.ec import SECP256R1, generate_private_key
from cryptography.hazmat.primitives.serialization import Encoding, NoEncryption, PrivateFormat, PublicFormat

from pcmrs.errors import JournalError
from pcmrs.journal import Journal, JournalReader, copy_journal, verify
from pcmrs.journal.rows import encode_row
from pcmrs.journal.writer import JournalWriter
from pcmrs.testing.journal import HEAD, NAME, place
from pcmrs_lab.campaign.damage import append_without_key
from tests.unit.journal.journal_rows import row
from tests.unit.journal.whole_journal import LOG, Sample, sample

OLD = Path(__file__).with_name("version_1.sqlite.gz")
_P256 = generate_private_key(SECP256R1())
OTHER_KIND = (
    _P256.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption()),
    _P256.public_key().public_bytes(Encoding.PEM, PublicFormat.SubjectPublicKeyInfo),
)
"""A private key and its public one, as PEM, of a kind that signs no head."""


@pytest.fixture
def killed(tmp_path: Path) -> Sample:
    (tmp_path / "whole").mkdir()
    return sample(tmp_path / "whole", killed=True)


@pytest.fixture
def path(killed: Sample, tmp_path: Path) -> Path:
    return place(killed.files, tmp_path / "cell")


@pytest.fixture
def old(tmp_path: Path) -> Path:
    (tmp_path / "old").mkdir()
    (tmp_path / "old" / NAME).write_bytes(gzip.decompress(OLD.read_bytes()))
    return tmp_path / "old" / NAME


def operations(path: Path) -> list[str | None]:
    with JournalReader(path) as reader:
        return [stored.row.operation for stored in reader.read(source="journal")]


def alter(path: Path, *statements: str) -> None:
    """As somebody with SQLite's own tool."""
    with sqlite3.connect(path) as connection:
        for statement in statements:
            connection.execute(statement)
    connection.close()


def test_lost_log_is_reported_with_the_number_of_rows(path: Path) -> None:
    path.with_name(LOG).unlink()
    with pytest.raises(JournalError, match=r"18 acknowledged rows are lost.*--good-part") as told:
        Journal.open(path)
    assert told.value.fields["missing"] == 18
    assert verify(path).missing == 18


async def test_journal_set_back_is_detected(path: Path, killed: Sample) -> None:
    journal = Journal.open(path)
    await journal.append([row()] * 3)
    await journal.close()
    kept = path.with_name(HEAD).read_bytes()
    later = place({**killed.files, HEAD: kept}, path.parent.with_name("set back"))
    with pytest.raises(JournalError, match="3 acknowledged rows are lost"):
        Journal.open(later)


async def test_head_stored_elsewhere_shows_that_all_was_set_back(path: Path, killed: Sample) -> None:
    journal = Journal.open(path)
    await journal.append([row()])
    await journal.close()
    kept = path.parent.parent / "kept.head"
    kept.write_bytes(path.with_name(HEAD).read_bytes())
    assert verify(path, kept=kept).sound
    set_back = place(killed.files, path.parent.with_name("set back"))
    assert verify(set_back).sound
    assert not verify(set_back, kept=kept).sound
    kept.write_bytes(killed.files[HEAD])
    assert verify(set_back, kept=kept).sound


@pytest.mark.parametrize(
    ("statement", "word"),
    [
        ("UPDATE journal SET body = CAST(replace(body, 'c3', 'x3') AS BLOB) WHERE sequence = 10", "row 10"),
        ("UPDATE journal SET kind = 'event' WHERE sequence = 11", "row 11"),
        ("UPDATE journal SET command_id = 'else' WHERE sequence = 10", "row 10"),
        ("DELETE FROM journal WHERE sequence = 7", "row 7 is missing"),
    ],
)
def test_edited_journal_is_reported_with_the_first_bad_row(path: Path, statement: str, word: str) -> None:
    guards = [f"DROP TRIGGER {name}" for name in ("no_update", "no_delete")]
    with JournalReader(path) as reader:
        select = "SELECT sql FROM sqlite_schema WHERE name IN ('no_update', 'no_delete')"
        again = [sql for (sql,) in reader._files[-1][1].execute(select)]
    alter(path, *guards, statement)
    with pytest.raises(JournalError, match="no_delete, no_update"):
        Journal.open(path)
    alter(path, *again)  # who does it well puts the guards back
    with pytest.raises(JournalError, match=word):
        Journal.open(path)
    found = verify(path)
    assert not found.sound
    assert f"row {found.first_bad}" in word
    assert found.rows == (found.first_bad or 0) - 1


def test_more_rows_than_a_crash_leaves_are_an_error(path: Path) -> None:
    append_without_key(path, [row()] * 600)
    with pytest.raises(JournalError, match="600 rows after the last one"):
        Journal.open(path)
    assert not verify(path).sound


async def test_unnamed_rows_left_by_a_crash_are_adopted_and_journalled(
    path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    journal = Journal.open(path, durable=False)
    monkeypatch.setattr(journal._writer._head, "write", lambda place: None)
    await journal.append([row(), row()])
    await journal.close()
    assert verify(path).unnamed == 2
    assert verify(path).sound
    for _ in range(2):
        await Journal.open(path).close()
    assert operations(path) == ["head_behind"]
    assert verify(path).unnamed == 0


async def test_one_torn_slot_is_enough_and_is_journalled(path: Path) -> None:
    head = path.with_name(HEAD)
    head.write_bytes(head.read_bytes()[:4096] + bytes(4096))
    assert verify(path).damaged_slots == 1
    for _ in range(2):
        await Journal.open(path).close()
    assert "head_damaged" in operations(path)
    assert verify(path).damaged_slots == 0


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
def test_without_its_head_or_key_nothing_is_written(path: Path, spoil: Callable[[Path], object], word: str) -> None:
    spoil(path.parent)
    with pytest.raises(JournalError, match=word):
        Journal.open(path)


def test_a_public_key_of_another_kind_verifies_nothing(path: Path, tmp_path: Path) -> None:
    other = tmp_path / "other.pub"
    other.write_bytes(OTHER_KIND[1])
    with pytest.raises(JournalError, match=r"other\.pub is not an Ed25519 key"):
        verify(path, public=other)


@pytest.mark.parametrize("lost", [("journal.key",), ("journal.key", "journal.pub")])
def test_a_lost_key_is_not_replaced(path: Path, lost: tuple[str, ...]) -> None:
    for name in lost:
        path.with_name(name).unlink()
    with pytest.raises(JournalError, match=r"journal\.key is missing, .*put it back from a copy"):
        Journal.open(path)
    assert not any(path.with_name(name).exists() for name in lost)


async def test_replaced_key_pair_is_detected(path: Path, tmp_path: Path) -> None:
    (tmp_path / "other").mkdir()
    await Journal.open(tmp_path / "other" / NAME).close()
    for name in ("journal.key", "journal.pub"):
        (path.parent / name).write_bytes((tmp_path / "other" / name).read_bytes())
    with pytest.raises(JournalError, match="another key"):
        Journal.open(path)
    assert verify(path).signature == "does not hold"
    (path.parent / HEAD).write_bytes((tmp_path / "other" / NAME).with_name(HEAD).read_bytes())
    assert not verify(path, public=tmp_path / "whole" / "journal.pub").sound


@pytest.mark.parametrize("replaced", ["journal.key", "journal.pub"])
async def test_mismatched_keys_are_detected(path: Path, tmp_path: Path, replaced: str) -> None:
    (tmp_path / "other").mkdir()
    await Journal.open(tmp_path / "other" / NAME).close()
    path.with_name(replaced).write_bytes((tmp_path / "other" / replaced).read_bytes())
    with pytest.raises(JournalError, match=r"journal\.pub does not belong to journal\.key beside it"):
        Journal.open(path)


def test_journal_that_lost_head_and_keys_is_not_sound(tmp_path: Path) -> None:
    """It is not taken for one that never had them."""
    path = tmp_path / NAME
    JournalWriter(path, durable=False).close()
    for name in (HEAD, "journal.key", "journal.pub"):
        path.with_name(name).unlink()
    found = verify(path)
    assert (found.signature, found.signed, found.sound) == ("does not hold", 0, False)


async def test_second_writer_is_refused_and_the_first_continues(path: Path) -> None:
    journal = Journal.open(path)
    with pytest.raises(JournalError, match="Another process writes"):
        Journal.open(path)
    assert await journal.append([row()]) == 19
    await journal.close()


async def test_journal_of_version_1_is_upgraded_and_that_is_journalled(old: Path) -> None:
    found = verify(old)
    assert found.sound
    assert found.signature == "none"
    for _ in range(2):
        journal = Journal.open(old)
        assert journal.reader.verdict_of("bus:local", "c2") is not None
        await journal.close()
    assert operations(old) == ["head_begun"]
    found = verify(old)
    assert found.sound
    assert (found.version, found.rows, found.signed) == (3, 9, 9)


def test_a_damaged_journal_of_version_1_is_left_as_it_is(old: Path) -> None:
    alter(old, "DROP TRIGGER no_update", "UPDATE journal SET wall = 0 WHERE sequence = 2")
    before = old.read_bytes()
    with pytest.raises(JournalError):
        Journal.open(old)
    assert old.read_bytes() == before
    assert not old.with_name(HEAD).exists()


async def test_a_journal_that_is_written_is_copied_with_its_head(path: Path, tmp_path: Path) -> None:
    (tmp_path / "copy").mkdir()
    journal = Journal.open(path)
    appended = [journal.append([row()]) for _ in range(50)]
    for _ in range(5):
        copy_journal(path, tmp_path / "copy" / NAME)
        assert verify(tmp_path / "copy" / NAME).sound
    for each in appended:
        await each
    await journal.close()
    assert verify(path).rows == 68


def test_only_the_end_is_read_when_a_snapshot_is_near(path: Path) -> None:
    """What lies before it is found by `verify`."""
    writer = JournalWriter(path, durable=False)
    for kind in ("event", "snapshot", "event"):
        writer.write([(row(kind), encode_row(row(kind)))])
    writer.close()
    with JournalReader(path) as reader:
        (guard,) = reader._files[-1][1].execute("SELECT sql FROM sqlite_schema WHERE name = 'no_update'").fetchone()
    alter(path, "DROP TRIGGER no_update", "UPDATE journal SET body = x'00' WHERE sequence = 3", guard)
    JournalWriter(path, durable=False).close()
    assert verify(path).first_bad == 3
    alter(path, "DROP TRIGGER no_update", "UPDATE journal SET body = x'00' WHERE sequence = 20", guard)
    with pytest.raises(JournalError, match="row 20"):
        JournalWriter(path, durable=False)
