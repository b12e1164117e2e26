"""`pcmrs fsm design`: from a table of steps to a verified blueprint."""

from __future__ import annotations

from pathlib import Path

import click

from pcmrs.cli.fsm.files import end_with, output_option, read, write
from pcmrs.cli.fsm.progress import search_bar


@click.command()
@click.argument("steps")
@output_option
def design(steps: str, output: Path | None) -> None:
    """Design a workflow from the critical operations in STEPS, a TOML file or - for standard input.

    Says how many of the 2^N combinations of N steps are possible and why the others are not, on standard error
    where the blueprint goes to standard output. Nothing is written unless the blueprint is sound.
    """
    from pcmrs.fsm.design import design as design_blueprint

    raw, origin = read(steps)
    with search_bar(origin) as progress:
        result = design_blueprint(raw, origin=origin, progress=progress)
    if result.combinations is not None:
        click.echo(str(result.combinations), err=output is None)
    if result.findings:
        end_with(result.findings, readable=result.readable)
    write(result.text, output)
