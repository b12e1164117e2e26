"""`pcmrs record` refuses what would record nothing; `pcmrs repair` saves what can be read, and changes nothing."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from pcmrs.bus.codec import pack
from pcmrs.recording.file import RecordingFile, Topics
from pcmrs.testing.daemon import free_port
from tests.unit.cli.command_line import run

COUNT = 2000


@pytest.fixture
def recorded(tmp_path: Path) -> Path:
    topics = Topics()
    file = RecordingFile(tmp_path / "run.mcap", topics, {"cell": "lab/cell1"})
    for number in range(COUNT):
        topics.write_raw("state/event", number * 0.01, pack({"text": f"{number:0200}"}), number * 10**7)
    file.close()
    return tmp_path / "run.mcap"


def test_a_whole_recording_is_copied_and_said_to_be_whole(recorded: Path, tmp_path: Path) -> None:
    ended = run("repair", str(recorded), "-o", str(tmp_path / "copy.mcap"))
    assert (ended.exit_code, ended.stdout) == (0, f"the file was whole: {COUNT} messages copied\n")


def test_of_a_cut_recording_the_readable_part_is_saved(recorded: Path, tmp_path: Path) -> None:
    whole = recorded.read_bytes()
    recorded.write_bytes(cut := whole[: len(whole) // 2])
    ended = run("repair", str(recorded), "-o", str(tmp_path / "saved.mcap"), "--json")
    assert ended.exit_code == 0, ended.stderr
    saved = json.loads(ended.stdout)
    assert not saved["complete"]
    assert 0 < saved["messages"] < COUNT
    assert saved["kept_bytes"] + saved["lost_bytes"] == len(cut)
    assert recorded.read_bytes() == cut, "the damaged file stays as it is"
    again = json.loads(run("repair", str(tmp_path / "saved.mcap"), "-o", str(tmp_path / "b.mcap"), "--json").stdout)
    assert (again["complete"], again["messages"]) == (True, saved["messages"])


def test_an_output_that_exists_is_not_overwritten(recorded: Path, tmp_path: Path) -> None:
    (tmp_path / "mine.mcap").write_bytes(b"mine")
    assert run("repair", str(recorded), "-o", str(tmp_path / "mine.mcap")).exit_code == 4
    assert (tmp_path / "mine.mcap").read_bytes() == b"mine"
    (tmp_path / "other").write_bytes(b"something else")
    assert run("repair", str(tmp_path / "other"), "-o", str(tmp_path / "new.mcap")).exit_code == 5
    assert not (tmp_path / "new.mcap").exists()


@pytest.mark.parametrize(
    ("words", "status", "text"),
    [
        (("--max-total", "4GB"), 2, "--max-total needs --max-size or --max-duration"),
        (("--max-size", "many"), 2, "not a size"),
        (("--max-duration", "0"), 2, "--max-duration"),
        (("--topics", "state//pose"), 4, "state//pose"),
        (("--set", "robot.model=iiwa9"), 4, "iiwa9"),
    ],
)
def test_options_that_cannot_be_meant_begin_no_recording(
    words: tuple[str, ...], status: int, text: str, tmp_path: Path
) -> None:
    ended = run("record", str(tmp_path / "run.mcap"), *words)
    assert ended.exit_code == status
    assert text in ended.stderr
    assert list(tmp_path.iterdir()) == []


def test_an_earlier_recording_is_not_overwritten(recorded: Path) -> None:
    before = recorded.read_bytes()
    ended = run("record", str(recorded), "--set", f"cell.endpoint=tcp/127.0.0.1:{free_port()}")
    assert ended.exit_code == 4
    assert recorded.read_bytes() == before
