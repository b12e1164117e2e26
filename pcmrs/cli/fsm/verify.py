"""`pcmrs fsm verify`: proves that workflows are sound, or shows why they are not."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING, Any

import click

from pcmrs.cli.fsm.files import EXIT_UNREADABLE, EXIT_UNSOUND, fetch, printable
from pcmrs.cli.options import json_option
from pcmrs.cli.printing import say, say_json
from pcmrs.cli.progress import search_bar
from pcmrs.cli.running import readable_errors
from pcmrs.errors import ConfigurationError
from pcmrs.extras import missing_module
from pcmrs.fsm.finding import unreadable_file

if TYPE_CHECKING:
    from pcmrs.fsm import BlueprintExamination
    from pcmrs.fsm.rules.declared import KnownHazards


@click.command()
@click.argument("files", metavar="FILE...", nargs=-1, required=True)
@click.option(
    "--limit", type=click.IntRange(min=1), default=2_000_000, show_default=True, help="Refuse more joint states."
)
@json_option
@readable_errors
def verify(files: tuple[str, ...], limit: int, as_json: bool) -> None:
    """Search all joint states of each FILE for violations of a rule or a property.

    A finding has its place in the file, and the commands that lead to it. Exit status 0: all are sound,
    1: one is not, 5: one cannot be read.
    """
    found = [_examine(file, limit) for file in files]
    if as_json:
        say_json([_as_object(origin, examination) for origin, examination in found])
    else:
        for origin, examination in found:
            _show(origin, examination)
    if not all(examination.readable for _, examination in found):
        sys.exit(EXIT_UNREADABLE)
    if not all(examination.sound for _, examination in found):
        sys.exit(EXIT_UNSOUND)


def _examine(file: str, limit: int) -> tuple[str, BlueprintExamination]:
    from pcmrs.fsm import BlueprintExamination, examine

    try:
        raw, origin, folder = fetch(file)
    except ConfigurationError as error:
        origin = printable(file)
        return origin, BlueprintExamination(None, [unreadable_file(origin, error.text)])
    with search_bar(origin) as progress:
        return origin, examine(raw, origin=origin, folder=folder, limit=limit, progress=progress, known=_known(raw))


def _known(raw: bytes) -> KnownHazards | None:
    """Return the known effects of PCMRS's own steps; they are not loaded for a file that names none."""
    if b"steps" not in raw and b"extends" not in raw and b"activities" not in raw:
        return None
    try:
        from pcmrs.workflows.opening import placement_registry
    except ModuleNotFoundError as error:
        missing = missing_module(error)
        if missing is None:
            raise
        say(f"The effects of PCMRS's own steps are not checked. {missing.text}", err=True)
        return None
    return placement_registry().known


def _as_object(origin: str, examination: BlueprintExamination) -> dict[str, Any]:
    return {
        "file": origin,
        "readable": examination.readable,
        "sound": examination.sound,
        "joint_states": examination.joint_states,
        "transitions": examination.transitions,
        "findings": examination.findings,
        "warnings": examination.warnings,
    }


def _show(origin: str, examination: BlueprintExamination) -> None:
    for warning in examination.warnings:
        say(warning.heading, err=True)
    if examination.blueprint is not None and examination.sound:
        searched = f"{examination.joint_states} joint states, {examination.transitions} transitions"
        say(f"{origin}: sound: {searched}, {len(examination.blueprint.properties)} properties")
        return
    for finding in examination.findings:
        say(finding.heading)
        for number, command in enumerate(finding.commands or (), 1):
            say(f"    {number}. {command}")
    word = "unsound" if examination.readable else "unreadable"
    number = len(examination.findings)
    say(f"{origin}: {word}: {number} finding{'s' if number != 1 else ''}")
