"""A journal is damaged where the damage says, and at no other place; a forged one has the format that it claims."""

from __future__ import annotations

import asyncio
import random
from pathlib import Path

import pytest

from pcmrs.errors import JournalError
from pcmrs.journal import Journal, JournalReader, verify
from pcmrs.testing.journal import HEAD, NAME, contents, place
from pcmrs_lab.campaign.damage import TAIL, Damage, append_past_head, append_without_key, as_version_1, damages
from pcmrs_lab.campaign.sham import sham
from pcmrs_lab.campaign.writing import row
from tests.unit.lab.scripted_client import row as decision


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> dict[str, bytes]:
    """The files of a closed journal with two decisions, a snapshot and an event."""

    async def write() -> None:
        journal = Journal.open(folder / NAME)
        rows = [decision("intent", operation="home"), decision("outcome"), decision("snapshot"), row("run0", 0, 1)]
        await journal.append(rows)
        await journal.close()

    folder = tmp_path_factory.mktemp("journal")
    asyncio.run(write())
    return contents(folder)


@pytest.fixture
def journal(files: dict[str, bytes], tmp_path: Path) -> Path:
    return place(files, tmp_path / "copy")


def changed(files: dict[str, bytes], folder: Path) -> list[str]:
    after = contents(folder)
    return sorted(name for name in files | after if files.get(name) != after.get(name))


def test_a_cut_leaves_the_bytes_before_it(files: dict[str, bytes], journal: Path) -> None:
    Damage(NAME, 100).apply(journal.parent)
    assert journal.read_bytes() == files[NAME][:100]
    assert changed(files, journal.parent) == [NAME]


def test_a_flip_inverts_one_bit(files: dict[str, bytes], journal: Path) -> None:
    Damage(HEAD, 3, flip=7).apply(journal.parent)
    before, after = files[HEAD], (journal.parent / HEAD).read_bytes()
    assert [(place, a ^ b) for place, (a, b) in enumerate(zip(before, after, strict=True)) if a != b] == [(3, 0x80)]


def test_a_file_is_removed(files: dict[str, bytes], journal: Path) -> None:
    Damage(HEAD, -1).apply(journal.parent)
    assert changed(files, journal.parent) == [HEAD]
    assert not (journal.parent / HEAD).exists()


@pytest.mark.parametrize("damage", [Damage(NAME, 9), Damage(HEAD, -1), Damage(HEAD, 3, flip=0)])
def test_nothing_is_damaged_in_a_sham_campaign(files: dict[str, bytes], journal: Path, damage: Damage) -> None:
    with sham():
        damage.apply(journal.parent)
    assert not changed(files, journal.parent)


@pytest.mark.parametrize(
    ("damage", "text"),
    [
        (Damage("a", 9), "a cut at byte 9"),
        (Damage("a", -1), "a removed"),
        (Damage("a", 9, flip=0), "a bit 0 flipped in byte 9"),
    ],
)
def test_a_damage_says_what_it_does(damage: Damage, text: str) -> None:
    assert str(damage) == text


@pytest.mark.parametrize("flips", [True, False])
def test_random_damages_are_within_their_files(files: dict[str, bytes], journal: Path, flips: bool) -> None:
    found = damages([journal.parent], 200, random.Random(1), flips=flips)
    assert len(found) == 200
    assert {damage.file for _, damage in found} == set(files)
    assert all((0 if flips else -1) <= damage.place < len(files[damage.file]) for _, damage in found)
    assert {damage.flip for _, damage in found} == (set(range(8)) if flips else {None})


def test_the_same_seed_damages_the_same_places(journal: Path) -> None:
    first, again, other = (damages([journal.parent], 9, random.Random(seed), flips=True) for seed in (1, 1, 2))
    assert first == again != other


def test_every_byte_of_the_tails_is_damaged_once(files: dict[str, bytes], journal: Path) -> None:
    places = [(each.file, each.place) for _, each in damages([journal.parent], None, random.Random(1), flips=False)]
    assert len(set(places)) == len(places)
    assert {place for file, place in places if file == NAME} == set(range(len(files[NAME]) - TAIL, len(files[NAME])))
    named = {place for file, place in places if file == HEAD}
    assert named == {place for place, byte in enumerate(files[HEAD]) if byte}, "its padding says nothing"


def test_a_file_without_content_cannot_have_a_flipped_bit(tmp_path: Path) -> None:
    (tmp_path / "empty").write_bytes(b"")
    (tmp_path / "short").write_bytes(b"x")
    flipped = {damage.file for _, damage in damages([tmp_path], 50, random.Random(1), flips=True)}
    assert flipped == {"short"}
    cut = {str(damage) for _, damage in damages([tmp_path], 50, random.Random(1), flips=False)}
    assert cut == {"empty removed", "short removed", "short cut at byte 0"}


def test_version_1_has_the_decisions_without_a_key(journal: Path) -> None:
    assert as_version_1(journal) == 2
    assert list(contents(journal.parent)) == [NAME]
    with JournalReader(journal) as reader:
        assert [stored.row.kind for stored in reader.read()] == ["intent", "outcome"]
    assert verify(journal).sound


def test_a_sham_campaign_leaves_the_newest_version(files: dict[str, bytes], journal: Path) -> None:
    with sham():
        assert as_version_1(journal) == 2
    assert journal.read_bytes() == files[NAME]
    assert (journal.parent / HEAD).exists()


def test_rows_without_the_key_are_chained_but_not_believed(journal: Path) -> None:
    append_without_key(journal, [row("forged", 0, 1), row("forged", 0, 2)])
    with JournalReader(journal) as reader:
        assert [stored.row.session_id for stored in reader.read()][-2:] == ["forged", "forged"]
    with pytest.raises(JournalError):
        Journal.open(journal)


async def test_rows_past_the_head_are_those_of_a_crash(files: dict[str, bytes], journal: Path) -> None:
    append_past_head(journal, [row("late", 0, 1)])
    assert (journal.parent / HEAD).read_bytes() == files[HEAD]
    opened = Journal.open(journal)
    sessions = [stored.row.session_id for stored in opened.reader.read()]
    await opened.close()
    assert "late" in sessions, "a crash makes no journal unusable"
