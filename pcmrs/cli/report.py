"""`pcmrs report`: a session as one page for clinicians, with all details behind it."""

from __future__ import annotations

import sys
from pathlib import Path

import click

from pcmrs.cli.options import OutputFile, json_option
from pcmrs.cli.printing import say, say_json
from pcmrs.cli.running import EXIT_REJECTED, readable_errors


@click.command()
@click.argument("path", metavar="SESSION", type=click.Path(path_type=Path))
@click.option(
    "-o",
    "--output",
    type=OutputFile(),
    metavar="FILE.html",
    default=Path("report.html"),
    show_default=True,
    help="HTML file to write.",
)
@click.option("--pdf", type=OutputFile(), metavar="FILE.pdf", help="Also write the page as PDF, on A4.")
@click.option("--session", metavar="ID", help="First characters of the session's id; by default the last session.")
@json_option
@readable_errors
def report(path: Path, output: Path, pdf: Path | None, session: str | None, as_json: bool) -> None:
    """Write the report of a session: one page for a clinician, then all details.

    SESSION is a folder of pcmrs export-session, the folder of a cell, or a journal (*.sqlite). Everything is taken
    from there; nothing is changed, and a daemon may be running. The same session gives the same bytes.

    Exit status: 0 written, 1 written, but the journal is damaged or a file differs from its export, as the report
    says; 2 nothing can be read.

    Example: pcmrs report session1 -o report.html --pdf report.pdf
    """
    _check_ending(output, ".html")
    if pdf is not None:
        _check_ending(pdf, ".pdf")
    from pcmrs.report.figures import draw_figures
    from pcmrs.report.page import render_page
    from pcmrs.report.reading import read_report

    found = read_report(path, session)
    page = render_page(found, draw_figures(found))
    _write(output, page.encode())
    if pdf is not None:
        from pcmrs.report.pdf import render_pdf

        _write(pdf, render_pdf(page, found.begun))
    if as_json:
        say_json(found)
    else:
        say(f"The report of {found.patient or 'a patient not named'} is in {output}.")
        for problem in found.problems:
            say(f"not sound: {problem}", err=True)
    if found.problems:
        sys.exit(EXIT_REJECTED)


def _check_ending(path: Path, ending: str) -> None:
    """Refuse a file of another kind: a typing error must not overwrite a journal."""
    if path.suffix.lower() != ending:
        raise click.UsageError(f"{path} does not end in {ending}: name it so.")


def _write(path: Path, content: bytes) -> None:
    """Write the file as a whole, or not at all."""
    part = path.with_name(f"{path.name}.part")
    try:
        part.write_bytes(content)
        part.replace(path)
    finally:
        part.unlink(missing_ok=True)
