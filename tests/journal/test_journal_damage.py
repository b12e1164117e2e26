"""Files of a journal cut at any byte, or with any bit turned over: never fewer rows in silence, never another error."""

from __future__ import annotations

import random
from collections.abc import Iterator
from pathlib import Path

import pytest
from damaged import HEAD, LOG, NAME, Files, Sample, cut, flip, place, sample, taken_up

Damage = tuple[str, Files]


@pytest.fixture(params=["killed", "closed"])
def whole(request: pytest.FixtureRequest, tmp_path: Path) -> Sample:
    (tmp_path / "whole").mkdir()
    return sample(tmp_path / "whole", killed=request.param == "killed")


def check(whole: Sample, folder: Path, damages: Iterator[Damage]) -> dict[str, bool]:
    """What was done to the files, to whether all rows were taken up nevertheless."""
    found = {}
    for what, files in damages:
        try:
            found[what] = taken_up(whole, place(files, folder))
        except Exception as error:
            raise AssertionError(what) from error
    return found


def some(whole: Sample, times: int) -> Iterator[Damage]:
    """Cuts and flips at random places of every file, and every file removed and emptied."""
    chance = random.Random(1)
    for name, content in sorted(whole.files.items()):
        for length in {-1, 0, 1, len(content) - 1, *(chance.randrange(len(content)) for _ in range(times))}:
            yield f"cut {name} {length}", cut(whole.files, name, length)
        for bit in {chance.randrange(8 * len(content)) for _ in range(times)}:
            yield f"flip {name} {bit}", flip(whole.files, name, bit)


def test_damage_is_never_passed_over(whole: Sample, tmp_path: Path) -> None:
    found = check(whole, tmp_path / "damaged", some(whole, 12))
    taken = {what for what, whole_still in found.items() if whole_still}
    assert not {f"cut {NAME} {length}" for length in (-1, 0)} & taken
    assert not {f"cut {HEAD} {length}" for length in (-1, 0)} & taken
    log = {what for what in found if LOG in what}
    assert not log & taken  # its last frame is the last row
    assert any(what.startswith(f"flip {HEAD}") for what in taken)  # one slot is enough


def test_what_is_not_damaged_is_taken_up(whole: Sample, tmp_path: Path) -> None:
    assert taken_up(whole, place(whole.files, tmp_path / "same"))


@pytest.mark.nightly
@pytest.mark.timeout(7200)
def test_a_cut_at_any_byte_is_never_passed_over(whole: Sample, tmp_path: Path) -> None:
    check(
        whole,
        tmp_path / "damaged",
        (
            (f"{name} {length}", cut(whole.files, name, length))
            for name in whole.files
            for length in range(-1, len(whole.files[name]))
        ),
    )


@pytest.mark.nightly
@pytest.mark.timeout(7200)
def test_a_flip_in_any_byte_is_never_passed_over(whole: Sample, tmp_path: Path) -> None:
    chance = random.Random(2)
    check(
        whole,
        tmp_path / "damaged",
        (
            (f"{name} {bit}", flip(whole.files, name, bit))
            for name in whole.files
            for bit in (8 * byte + chance.randrange(8) for byte in range(len(whole.files[name])))
        ),
    )
