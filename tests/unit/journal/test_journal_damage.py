"""Files of a journal cut at any byte, or with any bit turned over: never fewer rows in silence, never another error."""

from __future__ import annotations

import random
import shutil
from collections.abc import Iterable, Iterator
from pathlib import Path

import pytest

from pcmrs.testing.errors import Unmet
from pcmrs.testing.journal import HEAD, NAME, Damage, place
from pcmrs.testing.journal_recovery import is_recovered
from tests.unit.journal.whole_journal import LOG, Sample, sample


@pytest.fixture(params=["killed", "closed"])
def killed(request: pytest.FixtureRequest) -> bool:
    return bool(request.param == "killed")


@pytest.fixture
def whole(killed: bool, tmp_path: Path) -> Sample:
    (tmp_path / "whole").mkdir()
    return sample(tmp_path / "whole", killed=killed)


@pytest.fixture
def short(killed: bool, tmp_path: Path) -> Sample:
    """Of two commits, so that every byte can be tried within minutes."""
    (tmp_path / "short").mkdir()
    return sample(tmp_path / "short", killed=killed, commits=2)


def check(whole: Sample, folder: Path, damages: Iterable[Damage]) -> dict[Damage, bool]:
    """What was done to the files, to whether all rows were taken up nevertheless."""
    found = {}
    for damage in damages:
        path = place(whole.files, folder)
        damage.apply(folder)
        try:
            found[damage] = is_recovered(path, whole.rows)
        except Exception as error:
            raise AssertionError(str(damage)) from error
        shutil.rmtree(folder)
    return found


def some(whole: Sample, times: int) -> Iterator[Damage]:
    """Cuts and flips at random places of every file, and every file removed and emptied."""
    chance = random.Random(1)
    for name, content in sorted(whole.files.items()):
        for length in {-1, 0, 1, len(content) - 1, *(chance.randrange(len(content)) for _ in range(times))}:
            yield Damage(name, length)
        for byte in {chance.randrange(len(content)) for _ in range(times)}:
            yield Damage(name, byte, chance.randrange(8))


def test_damage_is_never_passed_over(whole: Sample, tmp_path: Path) -> None:
    found = check(whole, tmp_path / "damaged", some(whole, 12))
    taken = {damage for damage, whole_still in found.items() if whole_still}
    assert not {Damage(name, length) for name in (NAME, HEAD) for length in (-1, 0)} & taken
    assert not [damage for damage in taken if damage.file == LOG]  # its last frame is the last row
    assert [damage for damage in taken if damage.file == HEAD and damage.flip is not None]  # one slot is enough


def test_undamaged_journal_is_resumed(whole: Sample, tmp_path: Path) -> None:
    assert is_recovered(place(whole.files, tmp_path / "same"), whole.rows)


def test_rows_that_nobody_misses_are_seen(whole: Sample, tmp_path: Path) -> None:
    """A journal of fewer rows is sound in itself."""
    (tmp_path / "other").mkdir()
    other = sample(tmp_path / "other", killed=False, commits=len(whole.rows) // 3 - 1)
    with pytest.raises(Unmet, match="rows are missing or changed"):
        is_recovered(place(other.files, tmp_path / "placed"), whole.rows)


@pytest.mark.nightly
@pytest.mark.timeout(1800)
def test_a_cut_at_any_byte_is_never_passed_over(short: Sample, tmp_path: Path) -> None:
    damages = (Damage(name, length) for name, content in short.files.items() for length in range(-1, len(content)))
    check(short, tmp_path / "damaged", damages)


@pytest.mark.nightly
@pytest.mark.timeout(1800)
def test_a_flip_in_any_byte_is_never_passed_over(short: Sample, tmp_path: Path) -> None:
    chance = random.Random(2)
    damages = (
        Damage(name, byte, chance.randrange(8)) for name, content in short.files.items() for byte in range(len(content))
    )
    check(short, tmp_path / "damaged", damages)
