"""Files that `pcmrs fsm` reads and writes, and the results of commands that make a blueprint."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any, NamedTuple, NoReturn

import click
import msgspec

from pcmrs.cli.printing import say, say_lines, write_document
from pcmrs.cli.running import EXIT_FAILED, say_problem
from pcmrs.errors import ConfigurationError
from pcmrs.fsm import Blueprint, examine
from pcmrs.fsm.files.toml import MAX_BYTES, read_bounded
from pcmrs.fsm.finding import Finding


def check_json_output(output: Path | None, *, as_json: bool) -> None:
    """Refuse to mix the blueprint with the JSON object on standard output.

    Args:
        output: File for the blueprint; None for standard output.
        as_json: A JSON object is printed.

    Raises:
        click.UsageError: Both would go to standard output.
    """
    if as_json and str(output) == "-":
        raise click.UsageError("--json prints its object on standard output: give -o a file for the blueprint.")


def conclude(origin: str, findings: list[Finding], *, readable: bool, as_json: bool, **more: Any) -> None:
    """Report the findings, and end the command if there are any: unsound, or unreadable.

    Args:
        origin: Name of the file in findings.
        findings: All findings.
        readable: The file is of the kind that the command reads.
        as_json: Print one object instead of a line for each finding.
        more: Further keys of that object.
    """
    if not as_json:
        return fail_with_findings(findings, readable=readable) if findings else None
    result = {"file": origin, "readable": readable, "sound": readable and not findings, "findings": findings, **more}
    # Counts of combinations have more digits than msgspec writes.
    say(json.dumps(msgspec.to_builtins(result), ensure_ascii=False))
    if findings:
        sys.exit(EXIT_UNSOUND if readable else EXIT_UNREADABLE)


EXIT_UNSOUND = 1
EXIT_UNREADABLE = EXIT_FAILED

file_argument = click.argument("file")
output_option = click.option(
    "-o", "--output", type=click.Path(dir_okay=False, path_type=Path), help="Write to this file, not to the terminal."
)


class SourceFile(NamedTuple):
    """A file that was read.

    Attributes:
        raw: Its bytes; of a huge file, only so many that it is refused as too large.
        origin: Name of the file in findings.
        folder: Folder of the file; None for standard input.
    """

    raw: bytes
    origin: str
    folder: Path | None


def fetch(file: str) -> SourceFile:
    """Return the bytes of a file, with its origin.

    Args:
        file: The name of an installed workflow, a path with a folder or suffix, or ``-`` for standard input.

    Raises:
        ConfigurationError: It cannot be read, or no workflow has that name.
    """
    try:
        if file == "-":
            return SourceFile(_standard_input(), "<stdin>", None)
        path = _installed(file) if file.isidentifier() else Path(file)
        return SourceFile(read_bounded(path), printable(str(path)), path.parent)
    except (OSError, ValueError) as error:  # a ValueError for a text that cannot be a path
        reason = error.strerror if isinstance(error, OSError) else str(error)
        raise ConfigurationError(f"{printable(file)} cannot be read: {reason}.", file=file) from None


def printable(text: str) -> str:
    """Return a file's name as it can be printed: names may hold bytes that are not text."""
    return text.encode(errors="backslashreplace").decode()


def read(file: str) -> SourceFile:
    """Return the bytes of a file, with its origin, or end the command if it cannot be read."""
    try:
        return fetch(file)
    except ConfigurationError as error:
        refuse(error.text)


def sound(file: str, *, otherwise: int = EXIT_UNSOUND) -> Blueprint:
    """Return the sound workflow in a file, or print its findings and end the command.

    Args:
        file: See `fetch`.
        otherwise: Exit status for a workflow that is readable, but unsound.
    """
    raw, origin, folder = read(file)
    examination = examine(raw, origin=origin, folder=folder)
    if examination.blueprint is None or examination.findings:
        say_lines(map(str, examination.findings), err=True)
        sys.exit(otherwise if examination.readable else EXIT_UNREADABLE)
    return examination.blueprint


def fail_with_findings(findings: list[Finding], *, readable: bool) -> NoReturn:
    """Print findings to standard error and end the command.

    Args:
        findings: The findings.
        readable: The file could be read: the exit status is "unsound" instead of "unreadable".
    """
    say_lines(map(str, findings), err=True)
    sys.exit(EXIT_UNSOUND if readable else EXIT_UNREADABLE)


def refuse(text: str) -> NoReturn:
    """End a command that cannot be done."""
    say_problem(text)
    sys.exit(EXIT_UNREADABLE)


def write(text: str | bytes, output: Path | None) -> None:
    """Write a result to a file, or to standard output.

    Args:
        text: The result.
        output: The file; None or ``-`` for standard output.
    """
    if output is None or str(output) == "-":
        write_document(text)
        return
    try:
        output.write_bytes(text.encode() if isinstance(text, str) else text)
    except OSError as error:
        refuse(f"{output} cannot be written: {error.strerror}.")


def _standard_input() -> bytes:
    if sys.stdin is None:  # closed by the shell with <&-
        raise ValueError("standard input is closed")
    return sys.stdin.buffer.read(MAX_BYTES + 1)


def _installed(name: str) -> Path:
    from pcmrs.workflows.find import find_workflow  # loads the procedures, which a mere path does not need

    return find_workflow(name).blueprint
