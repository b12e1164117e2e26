"""The file of finished tasks: nothing is lost, nothing foreign is overwritten, and half a line counts for nothing."""

from __future__ import annotations

from pathlib import Path

import pytest

from pcmrs.errors import ConfigurationError, FileFormatError
from pcmrs_lab.scale._finished import FinishedTasks


@pytest.fixture
def path(tmp_path: Path) -> Path:
    path = tmp_path / "finished.jsonl"
    with FinishedTasks(path, "m:f", "v1") as file:
        file.add([b'{"seed":1}', b'{"seed":2}'], [b"\xff one", b"two"])
    return path


def test_a_finished_task_is_found_again(path: Path) -> None:
    with FinishedTasks(path, "m:f", "v1") as file:
        assert (file.get(b'{"seed":1}'), file.get(b'{"seed":2}'), file.get(b'{"seed":3}')) == (
            b"\xff one",
            b"two",
            None,
        )


@pytest.mark.parametrize(("function", "version"), [("m:f", "v2"), ("m:g", "v1")])
def test_other_code_or_function_finds_nothing_and_keeps_all(path: Path, function: str, version: str) -> None:
    with FinishedTasks(path, function, version) as file:
        assert file.get(b'{"seed":1}') is None
        file.add([b'{"seed":1}'], [b"other"])
    with FinishedTasks(path, "m:f", "v1") as file:
        assert file.get(b'{"seed":1}') == b"\xff one"


@pytest.mark.parametrize("cut", [1, 5, 40])
def test_a_line_that_was_being_written_is_removed(path: Path, cut: int) -> None:
    whole = path.read_bytes()
    path.write_bytes(whole[:-cut])
    with FinishedTasks(path, "m:f", "v1") as file:
        assert (file.get(b'{"seed":1}'), file.get(b'{"seed":2}')) == (b"\xff one", None)
        file.add([b'{"seed":2}'], [b"two"])
    assert path.read_bytes() == whole


def test_another_run_may_not_use_the_same_file(path: Path) -> None:
    with FinishedTasks(path, "m:f", "v1"), pytest.raises(ConfigurationError, match="used by another run"):
        FinishedTasks(path, "m:f", "v1")


@pytest.mark.parametrize("line", [b"{}\n", b"no json\n", b"\n"])
def test_a_file_of_something_else_is_refused_unchanged(path: Path, line: bytes) -> None:
    path.write_bytes(path.read_bytes() + line)
    before = path.read_bytes()
    with pytest.raises(FileFormatError, match=r"Line 3 of .* is not a finished task"):
        FinishedTasks(path, "m:f", "v1")
    assert path.read_bytes() == before
