"""The folder that a session leaves: journal, configuration, tables, pictures, report, and the hashes of all of them."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import msgspec
import tomli_w

from pcmrs.analysis.mep_table import write_meps
from pcmrs.analysis.nibs_tables import write_nibs
from pcmrs.analysis.session import SessionRecord
from pcmrs.errors import ConfigurationError
from pcmrs.formats.mesh import Mesh
from pcmrs.journal import JournalReader, copy_journal
from pcmrs.journal.export import json_lines
from pcmrs.report.stimulation.figures import draw_figures
from pcmrs.report.stimulation.page import render_report
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
    """Make the folder, or takes one that is empty.

    Raises:
        ConfigurationError: There is something in it, or it is no folder.
        OSError: It cannot be made.
    """
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        text = f"{folder} is there already, and is not empty: name another folder, or move it away."
        raise ConfigurationError(text, folder=str(folder))
    folder.mkdir(parents=True, exist_ok=True)


def write_journal(source: Path, folder: Path) -> None:
    """Copy a journal, also one that is being written, with its head, and writes it as one row of JSON per line.

    Raises:
        JournalError: It cannot be read or copied.
        OSError: The folder cannot be written.
    """
    copy_journal(source, folder / JOURNAL)
    with JournalReader(folder / JOURNAL) as reader, (folder / ROWS).open("w", encoding="utf-8") as rows:
        rows.writelines(json_lines(reader.read()))


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
