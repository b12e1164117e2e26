"""`pcmrs fsm diff`: what a change of a workflow changes in its behaviour."""

from __future__ import annotations

import click
import msgspec

from pcmrs.cli.fsm.files import refuse, sound
from pcmrs.cli.options import json_option
from pcmrs.cli.running import readable_errors
from pcmrs.errors import BlueprintError


@click.command()
@click.argument("old")
@click.argument("new")
@json_option
@readable_errors
def diff(old: str, new: str, as_json: bool) -> None:
    """Say what the workflow NEW answers otherwise than OLD: joint states, accepted operations, where they lead.

    Comments, layout, order and titles do not count. Exit status 0: the same behaviour, 1: it differs, 2: one cannot
    be read or is too large.
    """
    from pcmrs.fsm.difference.compare import compare

    try:
        differences = compare(sound(old), sound(new))
    except BlueprintError as error:
        refuse(error.text)
    if as_json:
        click.echo(msgspec.json.encode(differences))
    else:
        for difference in differences:
            click.echo(difference.text)
        if not differences:
            click.echo("The same behaviour.")
    if differences:
        raise SystemExit(1)
