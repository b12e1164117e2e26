"""How a command that makes a blueprint says what came of it: to people, or with ``--json`` to programs."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import click
import msgspec

from pcmrs.cli.fsm.files import EXIT_UNREADABLE, EXIT_UNSOUND, end_with
from pcmrs.cli.printing import say
from pcmrs.fsm.finding import Finding


def check_json_output(output: Path | None, *, as_json: bool) -> None:
    """Raises `click.UsageError` where the blueprint would be mixed with the JSON object on standard output."""
    if as_json and str(output) == "-":
        raise click.UsageError("--json prints its object on standard output: give -o a file for the blueprint.")


def conclude(origin: str, findings: list[Finding], *, readable: bool, as_json: bool, **more: Any) -> None:
    """Says what is wrong, and ends the command where something is: unsound, or unreadable.

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
