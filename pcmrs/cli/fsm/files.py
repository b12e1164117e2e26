"""Files that `pcmrs fsm` reads and writes.

How a command that makes a blueprint says what came of it: to people, or with ``--json`` to programs.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any, NamedTuple, NoReturn

import click
import msgspec

from pcmrs.cli.printing import say
from pcmrs.errors import ConfigurationError
from pcmrs.fsm import Blueprint, examine
from pcmrs.fsm.files.toml import MAX_BYTES, read_bounded
from pcmrs.fsm.finding import Finding, summary


def check_json_output(output: Path | None, *, as_json: bool) -> None:
    """Raise `click.UsageError` where the blueprint would be mixed with the JSON object on standard output."""
    if as_json and str(output) == "-":
        raise click.UsageError("--json prints its object on standard output: give -o a file for the blueprint.")


def conclude(origin: str, findings: list[Finding], *, readable: bool, as_json: bool, **more: Any) -> None:
    """Say what is wrong, and ends the command where something is: unsound, or unreadable.

    Args:
        origin: How the file was named.
        findings: All that is wrong.
        readable: Whether the file is what the command reads.
        as_json: Print one object instead of a line for each finding.
        more: Further keys of that object.
    """
    if not as_json:
        return end_with(findings, readable=readable) if findings else None
    said = {"file": origin, "readable": readable, "sound": readable and not findings, "findings": findings, **more}
    # Counts of combinations have more digits than msgspec writes.
    say(json.dumps(msgspec.to_builtins(said), ensure_ascii=False))
    if findings:
        sys.exit(EXIT_UNSOUND if readable else EXIT_UNREADABLE)


EXIT_UNSOUND = 1
EXIT_UNREADABLE = 2

file_argument = click.argument("file")
output_option = click.option(
    "-o", "--output", type=click.Path(dir_okay=False, path_type=Path), help="Write to this file, not to the terminal."
)


class Source(NamedTuple):
    """A file that was read.

    Attributes:
        raw: Its bytes; of a huge one no more than shows that it is too large.
        origin: How findings call it.
        folder: Where it lies; None for standard input.
    """

    raw: bytes
    origin: str
    folder: Path | None


def fetch(file: str) -> Source:
    """The bytes of a file and where they are from.

    Args:
        file: The name of an installed workflow, a path with a folder or suffix, or ``-`` for standard input.

    Raises:
        ConfigurationError: It cannot be read, or there is no workflow of that name.
    """
    try:
        if file == "-":
            return Source(_standard_input(), "<stdin>", None)
        path = _installed(file) if file.isidentifier() else Path(file)
        return Source(read_bounded(path), printable(str(path)), path.parent)
    except (OSError, ValueError) as error:  # a ValueError where it cannot be a path
        reason = error.strerror if isinstance(error, OSError) else str(error)
        raise ConfigurationError(f"{printable(file)} cannot be read: {reason}.", file=file) from None


def printable(text: str) -> str:
    """A file's name as it can be printed: names may hold bytes that are no text."""
    return text.encode(errors="backslashreplace").decode()


def read(file: str) -> Source:
    """The same, for commands on one file: they end where it cannot be read."""
    try:
        return fetch(file)
    except ConfigurationError as error:
        refuse(error.text)


def sound(file: str, *, otherwise: int = EXIT_UNSOUND) -> Blueprint:
    """The sound workflow in a file; otherwise the findings are printed and the command ends.

    Args:
        file: See `fetch`.
        otherwise: Exit status for one that is readable, but unsound.
    """
    raw, origin, folder = read(file)
    examination = examine(raw, origin=origin, folder=folder)
    if examination.blueprint is None or examination.findings:
        click.echo(summary(examination.findings), err=True)
        sys.exit(otherwise if examination.readable else EXIT_UNREADABLE)
    return examination.blueprint


def end_with(findings: list[Finding], *, readable: bool) -> NoReturn:
    """Print findings to standard error and ends: unsound where the file could be read, unreadable otherwise."""
    click.echo(summary(findings), err=True)
    sys.exit(EXIT_UNSOUND if readable else EXIT_UNREADABLE)


def refuse(text: str) -> NoReturn:
    """End a command that cannot be done."""
    click.echo(f"{click.get_current_context().command_path}: {text}", err=True)
    sys.exit(EXIT_UNREADABLE)


def write(text: str | bytes, output: Path | None) -> None:
    """Write a result to the file that was asked for, or to standard output (also for ``-``)."""
    if output is None or str(output) == "-":
        click.echo(text, nl=False)
        return
    try:
        output.write_bytes(text.encode() if isinstance(text, str) else text)
    except OSError as error:
        refuse(f"{output} cannot be written: {error.strerror}.")


def _standard_input() -> bytes:
    if sys.stdin is None:  # as the shell's <&- leaves it
        raise ValueError("standard input is closed")
    return sys.stdin.buffer.read(MAX_BYTES + 1)


def _installed(name: str) -> Path:
    from pcmrs.workflows.find import find_workflow  # loads the procedures: not for a mere path

    return find_workflow(name).blueprint
