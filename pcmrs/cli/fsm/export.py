"""`pcmrs fsm export`: a workflow for other tools."""

from __future__ import annotations

from pathlib import Path

import click

from pcmrs.cli.fsm.files import output_option, refuse, sound, write
from pcmrs.errors import BlueprintError

FORMATS = ("scxml", "promela", "json-schema", "table")


@click.command()
@click.argument("file", required=False)
@click.option("--format", "form", type=click.Choice(FORMATS), required=True, help="What to write.")
@output_option
def export(file: str | None, form: str, output: Path | None) -> None:
    """Write FILE for other tools.

    scxml: a state chart with the same behaviour, for tools that execute the W3C's SCXML. promela: a model for SPIN,
    with the properties of the workflow as claims. table: the transition table in Markdown. json-schema: the format of
    any blueprint, for editors; it needs no FILE.
    """
    if form == "json-schema":
        from pcmrs.authoring.exchange.exporting.schema import schema

        write(schema(), output)
    elif file is None:
        raise click.UsageError(f"--format {form} needs a FILE.")
    else:
        try:
            write(_exported(file, form), output)
        except BlueprintError as error:
            refuse(error.text)


def _exported(file: str, form: str) -> str:
    from pcmrs.authoring.exchange.exporting.promela import promela
    from pcmrs.authoring.exchange.exporting.scxml import scxml
    from pcmrs.authoring.exchange.exporting.table import table

    return {"scxml": scxml, "promela": promela, "table": table}[form](sound(file))
