"""What a killed console has left of a patient is removed at the next start, and what a living one has is not."""

from __future__ import annotations

import subprocess
import sys
import tempfile
from pathlib import Path

import pytest

from pcmrs.console.uploads import use_temporary_folder
from pcmrs.errors import ConfigurationError

HOLDER = """
import pathlib, sys, tempfile
from pcmrs.console.uploads import use_temporary_folder
use_temporary_folder(pathlib.Path(sys.argv[1]))
file = tempfile.NamedTemporaryFile(prefix="patient")
folder = tempfile.mkdtemp()
print(file.name, flush=True)
input()
"""


@pytest.fixture
def uploads(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr(tempfile, "tempdir", None)
    return tmp_path / "uploads"


def test_files_of_a_killed_process_are_removed_and_others_kept(uploads: Path) -> None:
    command, pipe = [sys.executable, "-c", HOLDER, str(uploads)], subprocess.PIPE
    with subprocess.Popen(command, stdin=pipe, stdout=pipe, text=True) as holder:
        assert holder.stdout is not None
        file = Path(holder.stdout.readline().strip())
        use_temporary_folder(uploads)
        assert file.exists()
        holder.kill()
    assert file.exists(), "nobody has removed it"

    use_temporary_folder(uploads)

    assert not file.exists()
    assert [path for path in uploads.rglob("*") if path.is_file()] == []


def test_all_temporary_files_are_its_own_and_its_owners_alone(uploads: Path) -> None:
    use_temporary_folder(uploads)
    with tempfile.NamedTemporaryFile() as file, tempfile.TemporaryDirectory() as own:
        (folder,) = uploads.iterdir()
        assert {Path(file.name), Path(own)} == {*folder.iterdir()}
        assert [path.stat().st_mode & 0o777 for path in (uploads, folder)] == [0o700, 0o700]


def test_folder_that_cannot_be_made_is_an_error(uploads: Path) -> None:
    uploads.touch()
    with pytest.raises(ConfigurationError, match="cannot be made"):
        use_temporary_folder(uploads)
