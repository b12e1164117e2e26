"""The folder of a session: journal, configuration, tables, figures, report, and the hashes of all of them."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import msgspec
import tomli_w

from pcmrs.analysis.mep_table import write_meps
from pcmrs.analysis.nibs_tables import write_nibs
from pcmrs.analysis.session import SessionRecord
from pcmrs.errors import ConfigurationError
from pcmrs.files import sha256_of
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
    """Create the folder, or accept an empty one.

    Raises:
        ConfigurationError: It is not empty, or not a folder.
        OSError: It cannot be created.
    """
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        text = f"{folder} already exists and is not empty: name another folder, or move it away."
        raise ConfigurationError(text, folder=str(folder))
    folder.mkdir(parents=True, exist_ok=True)


def write_journal(source: Path, folder: Path) -> None:
    """Copy a journal with its head, and write its rows as lines of JSON.

    Args:
        source: Journal; a daemon may be writing it.
        folder: Folder of the session.

    Raises:
        JournalError: The journal cannot be read or copied.
        OSError: The folder cannot be written.
    """
    copy_journal(source, folder / JOURNAL)
    with JournalReader(folder / JOURNAL) as reader, (folder / ROWS).open("w", encoding="utf-8") as rows:
        rows.writelines(json_lines(reader.read()))


def write_configuration(settings: Settings | Mapping[str, Any], folder: Path) -> None:
    """Write the whole configuration, as ``pcmrs-serve --config`` reads it.

    Args:
        settings: Settings of the session.
        folder: Folder of the session.
    """
    (folder / CONFIGURATION).write_text(tomli_w.dumps(_without_none(msgspec.to_builtins(settings))))


def write_results(record: SessionRecord, mesh: Mesh, folder: Path) -> None:
    """Write tables, figures and the report.

    Args:
        record: The session.
        mesh: Surface of the head in the image, m.
        folder: Folder of the session.

    Raises:
        OSError: A file cannot be written.
    """
    dataset, figures = folder / "bids", folder / "figures"
    write_nibs(record, dataset)
    write_meps(record, dataset / "derivatives" / "pcmrs")
    (dataset / "README").write_text(README)
    figures.mkdir()
    (folder / REPORT).write_text(render_report(record, draw_figures(record, mesh, figures)), encoding="utf-8")


def write_sums(folder: Path) -> None:
    """Write the hashes of all files, as ``sha256sum --check`` reads them."""
    files = sorted(path for path in folder.rglob("*") if path.is_file() and path.name != SUMS)
    lines = [f"{sha256_of(path).hex()}  {path.relative_to(folder).as_posix()}" for path in files]
    (folder / SUMS).write_text("\n".join(lines) + "\n")


def _without_none(value: Any) -> Any:
    """Return the value without None, which TOML cannot express."""
    if isinstance(value, Mapping):
        return {key: _without_none(each) for key, each in value.items() if each is not None}
    return [_without_none(each) for each in value] if isinstance(value, list | tuple) else value
