"""`pcmrs faults matrix`: which attackers were tested on which entry points."""

from __future__ import annotations

import click

from pcmrs.cli.options import json_option
from pcmrs.cli.printing import say_json, write_document
from pcmrs.cli.running import readable_errors


@click.command()
@json_option
@readable_errors
def matrix(as_json: bool) -> None:
    """Print which attackers were tested on which entry points, with the catalogue rows and tests that prove it.

    Example: pcmrs faults matrix
    """
    from pcmrs_lab.campaign.attacks import attacks, attacks_as_markdown

    if as_json:
        say_json(attacks())
    else:
        write_document(attacks_as_markdown())
