"""`pcmrs archive`: the journals of many cells in one place, and questions about all of them."""

from __future__ import annotations

import sys
from contextlib import closing
from pathlib import Path
from typing import TYPE_CHECKING

import click

from pcmrs.cli.lazy import LazyCommand, LazyGroup
from pcmrs.cli.options import OutputFile, config_options, json_option
from pcmrs.cli.printing import say, say_json
from pcmrs.cli.running import EXIT_FAILED, EXIT_REJECTED, readable_errors
from pcmrs.errors import PcmrsError

if TYPE_CHECKING:
    # For annotations only: asking for help must not load Arrow and DuckDB.
    import pyarrow as pa
    from rich.table import Table

    from pcmrs.archive import AddedRows, ArchiveVerification

COMMANDS = {name: LazyCommand(f"pcmrs.cli.archive:{name}") for name in ("add", "verify", "ask")}
COMMANDS["list"] = LazyCommand("pcmrs.cli.archive:list_")

LONG = 20_000
"""Number of rows from which it takes long enough for a bar."""

archive_option = click.option(
    "--archive",
    "place",
    required=True,
    envvar="PCMRS_ARCHIVE",
    metavar="PLACE",
    help="Folder of the archive, or postgresql://user@host/database.",
)
_file = click.Path(exists=True, dir_okay=False, path_type=Path)


class CellParamType(click.ParamType[tuple[str, str]]):
    """Site and name of a cell, such as lab/cell1."""

    name = "site/name"

    def convert(self, value: object, param: click.Parameter | None, ctx: click.Context | None) -> tuple[str, str]:
        """Return site and name, or fail with a usage error."""
        site, _, name = str(value).partition("/")
        if not (site and name) or "/" in name:
            self.fail(f"{value} is not a cell: write its site and name, such as lab/cell1.", param, ctx)
        return site, name


@click.group(cls=LazyGroup, commands=COMMANDS)
def archive() -> None:
    """Copy the journals of many cells to one place, verify it, and answer questions about all of them.

    The archive holds what the journals hold, patients' data included: its folder has mode 0700.
    """


@click.command()
@click.argument("paths", type=click.Path(path_type=Path), nargs=-1)
@archive_option
@click.option(
    "--cell", type=CellParamType(), help="Cell of the journals, if not the one that their daemon has journalled."
)
@json_option
@config_options
@readable_errors
def add(
    paths: tuple[Path, ...],
    place: str,
    cell: tuple[str, str] | None,
    as_json: bool,
    file: Path | None,
    overrides: tuple[str, ...],
) -> None:
    """Add the new rows of the journals at PATHS, or of the configured cell; of a folder, those of all its journals.

    The journals are only read, and their daemons may be running. Rows are added up to the last one that the signed head
    names, when all of them are proven. Repeat this as often as you like, also after a run that was killed. Exit status:
    0 all were added, 2 one could not be; the others were.

    Example: pcmrs archive add /srv/cell1 /srv/cell2 --archive /srv/archive
    """
    from pcmrs.archive import add_journal, find_journals, open_store
    from pcmrs.cli.journal import journal_of_cell
    from pcmrs.cli.progress import progress_bar

    journals = find_journals(paths or (journal_of_cell(file, overrides),))
    failed = False
    with closing(open_store(place, make=True)) as store:
        for path in journals:
            try:
                with progress_bar(beyond=LONG, transient=True) as progress:
                    added = add_journal(store, path, cell=cell, progress=progress)
            except PcmrsError as error:
                failed = True
                say(f"{path} was not added: {error.text}", err=True)
            else:
                _say_added(added, as_json=as_json)
    if failed:
        sys.exit(EXIT_FAILED)


@click.command()
@archive_option
@click.option(
    "--public-key",
    "keys",
    type=(CellParamType(), _file),
    multiple=True,
    metavar="SITE/NAME FILE",
    help="A cell's journal.pub that was kept elsewhere: reveals that its journal and key were replaced.",
)
@json_option
@readable_errors
def verify(place: str, keys: tuple[tuple[tuple[str, str], Path], ...], as_json: bool) -> None:
    """Read the whole archive, and report each segment that is missing, altered or doubled.

    Every hash and every column is computed again from the rows as their cells have written them, and compared with the
    signed heads. Exit status: 0 whole, 1 damaged, 5 there is no archive.
    """
    from pcmrs.archive import open_store, verify_archive
    from pcmrs.cli.progress import progress_bar
    from pcmrs.cli.tables import print_report

    with closing(open_store(place)) as store, progress_bar(transient=True) as progress:
        given = {"/".join(cell): path.read_bytes() for cell, path in keys}
        found = verify_archive(store, keys=given, progress=progress)
    print_report(found, _verified(found), as_json=as_json)
    if not found.sound:
        sys.exit(EXIT_REJECTED)


@click.command("list")
@archive_option
@json_option
@readable_errors
def list_(place: str, as_json: bool) -> None:
    """List the journals of the archive, as its catalogue has them, and the questions that it answers by name."""
    from pcmrs.archive import QUESTIONS, open_store
    from pcmrs.cli.tables import print_table

    with closing(open_store(place)) as store:
        found = {str(journal.name): store.segments(journal.name) for journal in store.journals()}
    rows = {name: segments[-1].last if segments else 0 for name, segments in found.items()}
    if as_json:
        say_json([{"journal": name, "segments": len(found[name]), "rows": rows[name]} for name in found])
        return
    table = _table("journal", "segments", "rows")
    for name, segments in found.items():
        table.add_row(name, str(len(segments)), str(rows[name]))
    print_table(table)
    for name, question in QUESTIONS.items():
        say(f"pcmrs archive ask {name}: {question.title}.")


@click.command()
@click.argument("name", metavar="QUESTION", required=False)
@click.option("--sql", help="One SELECT about the table rows, instead of QUESTION.")
@archive_option
@click.option("-o", "--output", type=OutputFile(), metavar="FILE", help="Write the answer to FILE.parquet or FILE.csv.")
@json_option
@readable_errors
def ask(name: str | None, sql: str | None, place: str, output: Path | None, as_json: bool) -> None:
    """Answer a QUESTION about all journals, such as stops; `pcmrs archive list` prints the others.

    An archive in a folder is asked in the SQL of DuckDB. If a segment is missing, there is no answer. Exit status: 0
    answered, 2 not.

    Example: pcmrs archive ask --sql "SELECT site, count(*) FROM rows GROUP BY site"
    """
    from pcmrs.archive import open_store
    from pcmrs.archive.answer import write_answer

    asked = _sql_of(name, sql)
    with closing(open_store(place)) as store, store.ask(asked) as answer:
        if output is not None:
            say(f"{write_answer(answer, output)} rows in {output}.")
        else:
            _say_answer(answer, as_json=as_json)


def _sql_of(name: str | None, sql: str | None) -> str:
    from pcmrs.archive import QUESTIONS

    if name is None and sql is not None:
        return sql
    if name is None or sql is not None:
        raise click.UsageError("Give one of QUESTION and --sql.")
    if name not in QUESTIONS:
        raise click.UsageError(f"There is no question {name}: ask {', '.join(QUESTIONS)}, or use --sql.")
    return QUESTIONS[name].sql


def _say_added(added: AddedRows, *, as_json: bool) -> None:
    if as_json:
        say_json(added)
    elif added.journal:
        say(f"{added.journal}: {added.added} rows added, {added.rows} in the archive.")
    else:
        say(f"{added.path} has no rows yet.")


def _say_answer(answer: pa.RecordBatchReader, *, as_json: bool) -> None:
    from pcmrs.archive.answer import rows_of
    from pcmrs.cli.tables import print_table

    if as_json:
        for row in rows_of(answer):
            say_json(row)
        return
    table = _table(*answer.schema.names)
    for row in rows_of(answer):
        table.add_row(*("" if value is None else _text(value) for value in row.values()))
    print_table(table)


def _text(value: object) -> str:
    if isinstance(value, float):
        return f"{value:.6g}"
    return value.hex() if isinstance(value, bytes) else str(value)


def _verified(found: ArchiveVerification) -> Table:
    table = _table("journal", "segments", "whole rows", "not proven yet", "SHA-256 of its key")
    for each in found.journals:
        table.add_row(each.journal, str(each.segments), str(each.rows), str(each.unproven), each.key[:16])
    for problem in found.problems:
        table.add_row(f"PROBLEM {problem.text}")
    for name in found.unlisted:
        table.add_row(f"{name} is not in the catalogue: a run was killed, and the next one replaces it.")
    return table


def _table(*columns: str) -> Table:
    from rich.box import SIMPLE_HEAD
    from rich.table import Table

    table = Table(box=SIMPLE_HEAD)
    for column in columns:
        table.add_column(column, overflow="fold")
    return table
