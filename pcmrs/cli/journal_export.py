"""`pcmrs journal export`: the rows of a journal as a file for other programs."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any

import click

from pcmrs.cli.journal import filter_options, journal_of_cell, path_argument
from pcmrs.cli.options import OutputFile, config_options
from pcmrs.cli.printing import say
from pcmrs.cli.progress import progress_bar
from pcmrs.cli.running import EXIT_REJECTED, readable_errors
from pcmrs.errors import JournalError
from pcmrs.journal import JournalReader, StoredRow
from pcmrs.journal.export import csv_lines, json_lines

LONG = 20_000
"""Number of rows from which it takes long enough for a bar."""

FORMATS: dict[str, Callable[[Iterable[StoredRow]], Iterator[str]]] = {".jsonl": json_lines, ".csv": csv_lines}


@click.command()
@path_argument
@click.option(
    "-o", "--output", required=True, type=OutputFile(), metavar="FILE", help="To be written: FILE.jsonl or FILE.csv."
)
@click.option("--good-part", is_flag=True, help="Export the rows of a damaged journal before the first bad one.")
@filter_options
@config_options
@readable_errors
def export(
    path: Path | None,
    output: Path,
    good_part: bool,
    filters: dict[str, Any],
    file: Path | None,
    overrides: tuple[str, ...],
) -> None:
    """Write the rows of the journal at PATH, or of the configured cell, into a file.

    JSON lines hold everything; a table omits the verdicts' texts. The exit status is 1 if a part was left out
    because it is damaged.
    """
    form = FORMATS.get(output.suffix)
    if form is None:
        raise click.UsageError(f"{output} has no format: name it .jsonl or .csv.")
    part = output.with_name(output.name + ".part")
    try:
        with JournalReader(path or journal_of_cell(file, overrides)) as reader:
            rows = _Rows(reader, filters, good_part)
            with part.open("w", encoding="utf-8", newline="") as written:
                written.writelines(form(rows))
        part.replace(output)
    finally:
        part.unlink(missing_ok=True)
    say(f"{rows.count} rows in {output}.")
    if rows.broken is not None:
        say(f"Only the good part was exported: {rows.broken.text}", err=True)
        sys.exit(EXIT_REJECTED)


class _Rows:
    """The rows that match the filters, counted and shown on a bar; with --good-part, until one is bad."""

    def __init__(self, reader: JournalReader, filters: dict[str, Any], good_part: bool) -> None:
        self._reader = reader
        self._filters = filters
        self._good_part = good_part
        self.count = 0
        self.broken: JournalError | None = None

    def __iter__(self) -> Iterator[StoredRow]:
        total = self._reader.last_sequence()
        with progress_bar(beyond=LONG, transient=True) as progress:
            try:
                for stored in self._fitting():
                    self.count += 1
                    if stored.sequence % 1000 == 0 or stored.sequence == total:
                        progress("rows", stored.sequence, total)
                    yield stored
            except JournalError as error:
                if not self._good_part:
                    raise
                self.broken = error

    def _fitting(self) -> Iterator[StoredRow]:
        if not self._good_part:
            yield from self._reader.read(**self._filters)
            return
        # Read the rows themselves: in a damaged journal, the columns beside them are not reliable.
        wanted = [(name, value) for name, value in self._filters.items() if value is not None]
        for stored in self._reader.read_whole():
            if all(getattr(stored.row, name) == value for name, value in wanted):
                yield stored
