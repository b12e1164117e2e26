"""Each byte that a campaign may damage is chosen; a journal of an older version has the format that it claims."""

from __future__ import annotations

import asyncio
import random
from pathlib import Path

import pytest

from pcmrs.journal import Journal, JournalReader, verify
from pcmrs.testing.journal import HEAD, NAME, contents, place, row
from pcmrs_lab.campaign.damage import TAIL, as_version_1, damages
from pcmrs_lab.campaign.sham import sham
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
