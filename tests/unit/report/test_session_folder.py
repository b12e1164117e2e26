"""The folder of a session: new, whole, and provable by its hashes."""

from __future__ import annotations

import hashlib
import tomllib
from pathlib import Path

import pytest

from pcmrs.errors import ConfigurationError
from pcmrs.journal import JournalReader
from pcmrs.journal.writer import JournalWriter
from pcmrs.report.session_folder import (
    CONFIGURATION,
    JOURNAL,
    README,
    REPORT,
    ROWS,
    SUMS,
    make_folder,
    write_configuration,
    write_journal,
    write_results,
    write_sums,
)
from pcmrs.settings import read_settings
from tests.support.session_records import mesh, record
from tests.unit.journal.journal_rows import ROW
from tests.unit.report import report_journals


@pytest.mark.parametrize("name", ["new", "new/in/new"])
def test_a_new_or_empty_folder_is_taken(tmp_path: Path, name: str) -> None:
    make_folder(tmp_path / name)
    make_folder(tmp_path / name)
    assert list((tmp_path / name).iterdir()) == []


def test_nothing_is_written_into_what_is_there(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("kept")
    for used in (tmp_path, tmp_path / "file"):
        with pytest.raises(ConfigurationError, match="already exists and is not empty"):
            make_folder(used)
    assert (tmp_path / "file").read_text() == "kept"


def test_configuration_is_read_as_it_was(tmp_path: Path) -> None:
    changed = ("procedure.patient=P-17", "procedure.registration.samples=7", "cell.rate=5")
    settings = read_settings(None, changed)
    write_configuration(settings, tmp_path)
    assert read_settings(tmp_path / CONFIGURATION) == settings


def test_values_that_toml_lacks_are_left_out(tmp_path: Path) -> None:
    write_configuration({"cell": {"rate": None, "name": "a"}, "boxes": [{"x": None, "y": (1, 2)}]}, tmp_path)
    written = tomllib.loads((tmp_path / CONFIGURATION).read_text())
    assert written == {"cell": {"name": "a"}, "boxes": [{"y": [1, 2]}]}


def test_a_copied_journal_has_the_rows_of_its_source(tmp_path: Path) -> None:
    source = report_journals.write_journal(report_journals.golden_rows("ratms")[:20], tmp_path / "cell" / "j.sqlite")
    folder = tmp_path / "session"
    folder.mkdir()
    write_journal(source, folder)
    with JournalReader(source) as original, JournalReader(folder / JOURNAL) as copy:
        assert list(copy.read()) == list(original.read())
    assert len((folder / ROWS).read_text().splitlines()) == 20


def test_a_journal_is_copied_while_it_is_written(tmp_path: Path) -> None:
    writer = JournalWriter(tmp_path / "live.sqlite", durable=False)
    writer.write([ROW])
    folder = tmp_path / "session"
    folder.mkdir()
    write_journal(tmp_path / "live.sqlite", folder)
    writer.close()
    with JournalReader(folder / JOURNAL) as copy:
        assert [stored.row for stored in copy.read()] == [ROW[0]]
    assert not list(folder.glob(f"{JOURNAL}-*")), "what is beside a journal that is being written is not copied"


def test_results_are_in_the_folder_with_a_hash_of_each(tmp_path: Path) -> None:
    write_results(record(), mesh(), tmp_path)
    write_sums(tmp_path)
    lines = [line.split("  ") for line in (tmp_path / SUMS).read_text().splitlines()]
    listed = {name: digest for digest, name in lines}
    there = {path.relative_to(tmp_path).as_posix(): path for path in tmp_path.rglob("*") if path.is_file()}
    assert set(listed) == set(there) - {SUMS}
    assert all(hashlib.sha256(there[name].read_bytes()).hexdigest() == digest for name, digest in listed.items())
    assert (tmp_path / "bids" / "README").read_text() == README
    assert {REPORT, "bids/dataset_description.json", "figures/hunt.svg"} <= set(listed)
