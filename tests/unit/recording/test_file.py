"""The file that is being written: what survives a killed writer and a failing disk."""

from __future__ import annotations

import errno
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from pcmrs.recording.file import CountingFile, RecordingFile, Topics
from pcmrs.recording.reader import RecordingReader


def test_killed_writer_loses_only_data_after_its_last_flush(tmp_path: Path) -> None:
    program = f"""
import os, signal, sys
sys.path[:0] = {sys.path!r}
from pathlib import Path
from pcmrs.recording.file import RecordingFile, Topics
topics = Topics()
file = RecordingFile(Path({str(tmp_path / "run.mcap")!r}), topics, {{"cell": "x"}})
for number in range(1000):
    topics.write_raw("state/x", float(number), b"%04d" % number + os.urandom(60), number)
    if number == 899:
        file.flush()
os.kill(os.getpid(), signal.SIGKILL)
"""
    ended = subprocess.run([sys.executable, "-c", program], capture_output=True, timeout=60, check=False)
    assert ended.returncode == -signal.SIGKILL, ended.stderr
    reading = RecordingReader(tmp_path / "run.mcap")
    numbers = [int(heard.payload[:4]) for _, heard in reading.bus_messages()]
    assert numbers == list(range(len(numbers)))
    assert len(numbers) >= 900
    assert not reading.complete


def test_after_the_first_disk_error_nothing_more_is_attempted(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The MCAP writer would report the error for each message, and could not be closed."""
    file, attempts = CountingFile(tmp_path / "run.mcap"), list[int]()

    class Full:
        name = "run.mcap"

        def write(self, data: bytes) -> int:
            attempts.append(len(data))
            raise OSError(errno.ENOSPC, f"No space left, attempt {len(attempts)}")

    assert file.write(b"12345") == 5
    file.flush()
    whole = file._file
    monkeypatch.setattr(file, "_file", Full())
    assert [file.write(b"123"), file.write(b"1234")] == [3, 4]
    assert attempts == [3]
    assert file.error is not None
    assert "attempt 1" in str(file.error)
    assert file.size == 12
    monkeypatch.setattr(file, "_file", whole)
    file.close()
    assert (tmp_path / "run.mcap").read_bytes() == b"12345"


def test_a_file_can_only_be_appended_to(tmp_path: Path) -> None:
    file = CountingFile(tmp_path / "run.mcap")
    file.write(b"123")
    assert file.seek(0, os.SEEK_CUR) == file.seek(3) == 3
    for offset, whence in ((0, os.SEEK_SET), (2, os.SEEK_SET), (-1, os.SEEK_CUR), (0, os.SEEK_END)):
        with pytest.raises(OSError, match="can only be appended to"):
            file.seek(offset, whence)
    file.close()
    with pytest.raises(FileExistsError):
        CountingFile(tmp_path / "run.mcap")


def test_topics_are_declared_anew_in_each_file(tmp_path: Path) -> None:
    """Each file can be read without the ones before it."""
    topics = Topics()
    for name in ("one.mcap", "two.mcap"):
        file = RecordingFile(tmp_path / name, topics, {"cell": "x", "file": name})
        topics.write_raw("state/x", 1.0, name.encode(), 1)
        file.close()
        assert file.error is None
        reading = RecordingReader(tmp_path / name)
        assert [sample.payload for _, sample in reading.bus_messages()] == [name.encode()]
        assert reading.origin == {"format": "1", "cell": "x", "file": name}
        assert file.size == (tmp_path / name).stat().st_size
