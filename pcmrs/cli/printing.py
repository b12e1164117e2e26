"""Output of commands. Text from outside cannot control the terminal, and cannot forge a line of PCMRS.

This module and `pcmrs.cli.tables` are the only ones that write to the terminal: ruff's list of banned names in
`pyproject.toml` has what escapes nothing, such as `click.echo` and Rich's `Text`.
"""

from __future__ import annotations

import sys
from collections.abc import Iterable

import click
import msgspec

from pcmrs.visible import visible


def say(text: str, *, err: bool = False, nl: bool = True) -> None:
    """Print one line.

    Args:
        text: The line.
        err: Print it on standard error.
        nl: End the line.
    """
    click.echo(visible(text), err=err, nl=nl)


def say_lines(lines: Iterable[str], *, err: bool = False) -> None:
    """Print lines.

    Args:
        lines: The lines, without line ends.
        err: Print them on standard error.
    """
    for line in lines:
        say(line, err=err)


def say_json(value: object) -> None:
    """Print a message, or anything else that `msgspec` can encode, as one line of JSON."""
    say(msgspec.json.encode(value).decode())


def write_document(document: str | bytes) -> None:
    """Write a document to standard output, without a further line end.

    A file or pipe gets it unchanged. A terminal gets its text escaped, except for line ends and tabs, because a
    document, such as an exported workflow, holds text of other people.

    Args:
        document: Text, or the bytes of a picture.
    """
    if isinstance(document, str) and sys.stdout is not None and sys.stdout.isatty():
        document = visible(document, keep="\n\t")
    click.echo(document, nl=False, color=True)  # otherwise, click drops escape sequences for a file or pipe
