"""`pcmrs fsm approve`: a person's signature on a drafted workflow, without which no daemon starts it."""

from __future__ import annotations

import sys
from pathlib import Path

import click
import msgspec

from pcmrs.cli.fsm.files import file_argument, refuse, sound
from pcmrs.cli.options import json_option
from pcmrs.cli.printing import say, say_json, say_lines
from pcmrs.cli.running import readable_errors
from pcmrs.clock import SystemClock
from pcmrs.fsm import Blueprint


@click.command()
@file_argument
@click.option(
    "--identity",
    type=click.Path(path_type=Path, file_okay=False),
    required=True,
    envvar="PCMRS_IDENTITY",
    help="Folder from `pcmrs pki issue`, with your key.",
)
@click.option("--yes", is_flag=True, help="You have reviewed it: do not ask.")
@json_option
@readable_errors
def approve(file: str, identity: Path, yes: bool, as_json: bool) -> None:
    """Sign the workflow FILE, which a language model has drafted, with your own key.

    Your name, the hash of the blueprint and the signature are written to FILE's name with .approval.json, beside it. A
    daemon whose register has you as an operator then starts the workflow, and its journal shows who has approved it.
    Any later change of the blueprint ends the approval. Exit status: 0 signed, 1 FILE is unsound, 5 it cannot be read,
    was not drafted, or is not confirmed, 4 the identity cannot be used.

    Example: pcmrs fsm approve biopsy.toml --identity ~/anna
    """
    from pcmrs.files import write_durably
    from pcmrs.pki import approval_file, read_credentials
    from pcmrs.pki import approve as sign

    if file == "-" or file.isidentifier():
        refuse("Name the file of the blueprint: the approval is written beside it.")
    blueprint = sound(file)
    if blueprint.provenance is msgspec.UNSET:
        refuse(f"{file} has no provenance of a draft: it needs no approval.")
    now = SystemClock().wall()
    own = read_credentials(identity, now)
    if not yes:
        _confirm(blueprint, own.name)
    approval = sign(blueprint, own, now)
    path = approval_file(Path(file))
    write_durably(path, msgspec.json.format(msgspec.json.encode(approval), indent=2) + b"\n", mode=0o644)
    if as_json:
        say_json({"file": str(path), "approval": approval})
    else:
        say(f"{path}: {own.name} has approved {blueprint.id} {blueprint.version}, hash {blueprint.hash}.")


def _confirm(blueprint: Blueprint, name: str) -> None:
    """Show what is signed, and ask; end the command unless the answer is yes."""
    if sys.stdin is None or not sys.stdin.isatty():
        refuse("Without a terminal nobody can be asked: review the workflow, then add --yes.")
    origin = blueprint.provenance
    lines = [f"{blueprint.id} {blueprint.version}, hash {blueprint.hash}"]
    if origin is not msgspec.UNSET:
        lines.append(f"drafted by {origin.model} on {origin.date}")
    lines += [f"requirement {each.id}: {each.text}" for each in blueprint.properties]
    say_lines(lines, err=True)
    if not click.confirm(f"Have you, {name}, compared it with the protocol, and do you approve it?", err=True):
        refuse("Nothing was signed.")
