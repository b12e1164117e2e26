"""`pcmrs fsm import`: a blueprint from a state chart of another tool."""

from __future__ import annotations

from pathlib import Path

import click

from pcmrs.cli.fsm.files import check_json_output, conclude, output_option, read, write
from pcmrs.cli.options import json_option

FORMATS = ("scxml", "mermaid", "drawio")
SUFFIXES = {".scxml": "scxml", ".mmd": "mermaid", ".mermaid": "mermaid", ".drawio": "drawio", ".dio": "drawio"}


@click.command("import")
@click.argument("file")
@click.option(
    "--from", "form", type=click.Choice(FORMATS), help="Format of FILE, if its name and content do not show it."
)
@output_option
@json_option
def import_(file: str, form: str | None, output: Path | None, as_json: bool) -> None:
    """Make a blueprint of a state chart in SCXML, Mermaid stateDiagram-v2 or draw.io XML.

    Regions become branches, nested states branches of the next level, events operations with that title. Anything that
    a blueprint cannot express is reported with its line and column, and nothing is written. You add steps, checks and
    roles. The result is verified: exit status 0: sound, 1: written, but unsound, 5: FILE cannot be imported. With
    --json, standard output gets one object with the result, and the blueprint is written with -o only.
    """
    from pcmrs.authoring.exchange.importing.drawio import from_drawio
    from pcmrs.authoring.exchange.importing.imported import blueprint_file
    from pcmrs.authoring.exchange.importing.mermaid import from_mermaid
    from pcmrs.authoring.exchange.importing.scxml import from_scxml

    check_json_output(output, as_json=as_json)
    raw, origin, _ = read(file)
    readers = {"scxml": from_scxml, "mermaid": from_mermaid, "drawio": from_drawio}
    blueprint, findings = readers[form or _format_of(raw, origin)](raw, origin)
    text = ""
    if blueprint is not None:
        text, findings = blueprint_file(blueprint, origin, str(output or "<blueprint>"))
    if text and (output is not None or not as_json):
        write(text, output)
    conclude(origin, findings, readable=bool(text), as_json=as_json)


def _format_of(raw: bytes, origin: str) -> str:
    """Return the format by the file's suffix, or else by its first bytes."""
    if (suffix := Path(origin).suffix.lower()) in SUFFIXES:
        return SUFFIXES[suffix]
    if not raw.lstrip(b"\xef\xbb\xbf \t\r\n").startswith(b"<"):
        return "mermaid"
    return "drawio" if b"<mxfile" in raw or b"<mxGraphModel" in raw else "scxml"
