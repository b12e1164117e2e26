"""Lines that commands print. Text from outside can neither control the terminal nor forge a line of PCMRS."""

from __future__ import annotations

import click
import msgspec

from pcmrs.visible import visible


def say(text: str, *, err: bool = False) -> None:
    """Print one line.

    Args:
        text: The line.
        err: Print it on standard error.
    """
    click.echo(visible(text), err=err)


def say_json(value: object) -> None:
    """Print a message, or anything else that `msgspec` can encode, as one line of JSON."""
    say(msgspec.json.encode(value).decode())
