"""The numbered files of a recording: their names, order and removal."""

from __future__ import annotations

from pathlib import Path

import pytest

from pcmrs.errors import ConfigurationError
from pcmrs.recording.series import (
    Limits,
    all_files,
    check_new,
    files_of,
    path_of,
    recordings_in,
    remove_oldest,
    session_files,
)


def test_taken_or_wrong_name_is_refused_at_once(tmp_path: Path) -> None:
    path_of(tmp_path / "run.mcap", 7).touch()
    for name in ("run.mcap", "run.bag", "missing/run.mcap"):
        with pytest.raises(ConfigurationError):
            check_new(tmp_path / name)
    check_new(tmp_path / "run2.mcap")


def test_files_of_a_recording_are_ordered_by_number_not_by_name(tmp_path: Path) -> None:
    first = tmp_path / "run.mcap"
    for number in (10_000, 2, 9_999, 1):
        path_of(first, number).touch()
    (tmp_path / "run.old.0001.mcap").touch()
    (tmp_path / "other.0001.mcap").touch()
    assert files_of(first) == [path_of(first, number) for number in (1, 2, 9_999, 10_000)]


@pytest.mark.parametrize(
    ("limit", "remaining"), [(1e9, [1, 2, 3, 4]), (100, [1, 2, 3, 4]), (99, [2, 3, 4]), (60, [3, 4]), (0, [4])]
)
def test_the_oldest_files_are_removed_and_the_last_one_stays(
    tmp_path: Path, limit: float, remaining: list[int]
) -> None:
    """Files of 10, 30, 20 and 40 bytes; the last one is being written."""
    first, gone = tmp_path / "run.mcap", list[tuple[Path, int]]()
    sizes = {1: 10, 2: 30, 3: 20, 4: 40}
    for number, size in sizes.items():
        path_of(first, number).write_bytes(bytes(size))
    remove_oldest(files_of(first), limit, lambda path, size: gone.append((path, size)))
    assert files_of(first) == [path_of(first, number) for number in remaining]
    assert gone == [(path_of(first, number), size) for number, size in sizes.items() if number not in remaining]


def test_recordings_are_told_apart_by_name_and_session(tmp_path: Path) -> None:
    one, other = tmp_path / "20260101T000000Z-aaaaaaaa.mcap", tmp_path / "20260102T000000Z-bbbbbbbb.mcap"
    for first, number in ((one, 2), (one, 1), (other, 1)):
        path_of(first, number).touch()
    (tmp_path / "mine.mcap").touch()
    assert session_files(tmp_path, ["aaaaaaaa-and-more"]) == [path_of(one, 1), path_of(one, 2)]
    assert session_files(tmp_path, ["cccccccc"]) == []
    assert all_files(tmp_path) == [path_of(one, 1), path_of(one, 2), path_of(other, 1)]
    assert recordings_in(tmp_path) == {
        one.stem: [path_of(one, 1), path_of(one, 2)],
        other.stem: [path_of(other, 1)],
        "mine": [tmp_path / "mine.mcap"],
    }


@pytest.mark.parametrize(
    ("limits", "numbered"),
    [(Limits(), False), (Limits(total_bytes=1.0), False), (Limits(file_s=1.0), True), (Limits(file_bytes=1.0), True)],
)
def test_files_are_numbered_if_there_may_be_several(limits: Limits, numbered: bool) -> None:
    assert limits.numbered == numbered
