"""`pcmrs faults matrix`: who was let loose on which way into a cell."""

from __future__ import annotations

import click

from pcmrs.cli.options import json_option
from pcmrs.cli.printing import say_json
from pcmrs.cli.running import readable_errors


@click.command()
@json_option
@readable_errors
def matrix(as_json: bool) -> None:
    """Say who was let loose on which way into a cell, and which rows of the catalogue and tests show that it fails.

    Example: pcmrs faults matrix
    """
    from pcmrs_lab.campaign.attacks import attacks, attacks_as_markdown

    if as_json:
        say_json(attacks())
    else:
        click.echo(attacks_as_markdown(), nl=False)
