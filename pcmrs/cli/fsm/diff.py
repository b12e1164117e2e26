"""`pcmrs fsm diff`: differences in behaviour between two versions of a workflow."""

from __future__ import annotations

import click

from pcmrs.cli.fsm.files import EXIT_UNREADABLE, refuse, sound
from pcmrs.cli.options import json_option
from pcmrs.cli.printing import say, say_json
from pcmrs.cli.running import readable_errors
from pcmrs.errors import BlueprintError


@click.command()
@click.argument("old")
@click.argument("new")
@json_option
@readable_errors
def diff(old: str, new: str, as_json: bool) -> None:
    """List the differences in behaviour of the workflows OLD and NEW: joint states, accepted operations, their targets.

    Goal, properties and declarations of operations count, too; comments, layout, order and titles do not. Exit status
    0: the same behaviour, 1: it differs, 5: one is unsound, cannot be read, or has over 20,000 joint states.
    """
    from pcmrs.authoring.difference import compare

    try:
        differences = compare(*(sound(file, otherwise=EXIT_UNREADABLE) for file in (old, new)))
    except BlueprintError as error:
        refuse(error.text)
    if as_json:
        say_json(differences)
    else:
        for difference in differences:
            say(difference.text)
        if not differences:
            say("The same behaviour.")
    if differences:
        raise SystemExit(1)
