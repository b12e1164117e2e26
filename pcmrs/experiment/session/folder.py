"""The folder that a session leaves: journal, configuration, tables, pictures, report, and the hashes of all of them."""

from __future__ import annotations

import hashlib
import sqlite3
from collections.abc import Mapping
from contextlib import closing
from pathlib import Path
from typing import Any

import msgspec
import tomli_w

from pcmrs.analysis.mep_table import write_meps
from pcmrs.analysis.nibs_tables import write_nibs
from pcmrs.analysis.report import draw_figures, render_report
from pcmrs.analysis.session import SessionRecord
from pcmrs.errors import ConfigurationError, JournalError
from pcmrs.formats.mesh import Mesh
from pcmrs.journal import JournalReader
from pcmrs.settings import Settings

JOURNAL, ROWS, CONFIGURATION, REPORT, SUMS = (
    "journal.sqlite",
    "journal.jsonl",
    "configuration.toml",
    "report.html",
    "SHA256SUMS",
)
README = """A session with transcranial magnetic stimulation by PCMRS: research software, not a medical device.

The folder nibs follows the NIBS-BIDS proposal (BEP037, version 6.3), which is not part of BIDS yet; derivatives/pcmrs
has the motor evoked potentials and the signals they were measured in. All of it is made from the journal, which lies
beside this folder.
"""


def make_folder(folder: Path) -> None:
    """Makes the folder, or takes one that is empty.

    Raises:
        ConfigurationError: There is something in it, or it is no folder.
        OSError: It cannot be made.
    """
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        text = f"{folder} is there already, and is not empty: name another folder, or move it away."
        raise ConfigurationError(text, folder=str(folder))
    folder.mkdir(parents=True, exist_ok=True)


def copy_journal(source: Path, folder: Path) -> None:
    """Copies a journal, also one that is being written: SQLite's own way, and as one row of JSON per line.

    Raises:
        JournalError: It cannot be read or copied.
    """
    try:
        with closing(sqlite3.connect(source)) as written, closing(sqlite3.connect(folder / JOURNAL)) as copy:
            written.backup(copy)
            copy.execute("PRAGMA journal_mode = DELETE")  # one file, which nobody writes any more
    except sqlite3.Error as error:
        raise JournalError(f"{source} cannot be copied to {folder}: {error}.", path=str(source)) from error
    with JournalReader(folder / JOURNAL) as reader, (folder / ROWS).open("wb") as rows:
        for stored in reader.read():
            rows.write(msgspec.json.encode(stored) + b"\n")


def write_configuration(settings: Settings | Mapping[str, Any], folder: Path) -> None:
    """The whole configuration in force, as ``pcmrs-serve --config`` reads it."""
    (folder / CONFIGURATION).write_text(tomli_w.dumps(_without_none(msgspec.to_builtins(settings))))


def write_results(record: SessionRecord, mesh: Mesh, folder: Path) -> None:
    """Tables, pictures, and the report that shows them. Raises `OSError`."""
    dataset, figures = folder / "bids", folder / "figures"
    write_nibs(record, dataset)
    write_meps(record, dataset / "derivatives" / "pcmrs")
    (dataset / "README").write_text(README)
    figures.mkdir()
    (folder / REPORT).write_text(render_report(record, draw_figures(record, mesh, figures)), encoding="utf-8")


def write_sums(folder: Path) -> None:
    """Hashes of all files, as ``sha256sum --check`` reads them."""
    files = sorted(path for path in folder.rglob("*") if path.is_file() and path.name != SUMS)
    lines = [
        f"{hashlib.sha256(path.read_bytes()).hexdigest()}  {path.relative_to(folder).as_posix()}" for path in files
    ]
    (folder / SUMS).write_text("\n".join(lines) + "\n")


def _without_none(value: Any) -> Any:
    """TOML has no word for what is not set: it is left out."""
    if isinstance(value, Mapping):
        return {key: _without_none(each) for key, each in value.items() if each is not None}
    return [_without_none(each) for each in value] if isinstance(value, list | tuple) else value
