"""`pcmrs fsm import`: a blueprint from a state chart of another tool."""

from __future__ import annotations

from pathlib import Path

import click

from pcmrs.cli.fsm.files import end_with, output_option, read, write

FORMATS = ("scxml", "mermaid", "drawio")
SUFFIXES = {".scxml": "scxml", ".mmd": "mermaid", ".mermaid": "mermaid", ".drawio": "drawio", ".dio": "drawio"}


@click.command("import")
@click.argument("file")
@click.option("--from", "form", type=click.Choice(FORMATS), help="What FILE is, where its name and content do not say.")
@output_option
def import_(file: str, form: str | None, output: Path | None) -> None:
    """Make a blueprint of a state chart in SCXML, Mermaid stateDiagram-v2 or draw.io XML.

    Regions become branches, nested states branches of the next level, events operations with that title; what a
    blueprint cannot express is named with its line and column, and nothing is written. Steps, checks and roles are to
    be added. The result is verified: exit status 0: sound, 1: written, but unsound, 2: FILE cannot be imported.
    """
    from pcmrs.fsm import examine
    from pcmrs.fsm.exchange.importing.drawio import from_drawio
    from pcmrs.fsm.exchange.importing.mermaid import from_mermaid
    from pcmrs.fsm.exchange.importing.scxml import from_scxml
    from pcmrs.fsm.files.dump import blueprint_toml

    raw, origin = read(file)
    readers = {"scxml": from_scxml, "mermaid": from_mermaid, "drawio": from_drawio}
    blueprint, findings = readers[form or _format_of(raw, origin)](raw, origin)
    if blueprint is None:
        end_with(findings, readable=False)
    text = blueprint_toml(blueprint, comment=f"Imported from {Path(origin).name}.")
    write(text, output)
    unsound = examine(text.encode(), origin=str(output or "<blueprint>")).findings
    if unsound:
        end_with(unsound, readable=True)


def _format_of(raw: bytes, origin: str) -> str:
    """The format by the file's suffix, or else by what it begins with."""
    if (suffix := Path(origin).suffix.lower()) in SUFFIXES:
        return SUFFIXES[suffix]
    if not raw.lstrip(b"\xef\xbb\xbf \t\r\n").startswith(b"<"):
        return "mermaid"
    return "drawio" if b"<mxfile" in raw or b"<mxGraphModel" in raw else "scxml"
