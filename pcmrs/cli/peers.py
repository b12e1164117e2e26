"""`pcmrs peers`: keys of clients that sign their commands."""

from __future__ import annotations

from pathlib import Path

import click
import msgspec

from pcmrs.cli.lazy import LazyCommand, LazyGroup
from pcmrs.cli.options import json_option
from pcmrs.cli.printing import say, say_json
from pcmrs.cli.running import readable_errors

COMMANDS = {"new": LazyCommand("pcmrs.cli.peers:new")}


@click.group(cls=LazyGroup, commands=COMMANDS)
def peers() -> None:
    """Give clients on other machines a key, so that the gateway accepts their commands."""


@click.command()
@click.argument("name")
@click.option(
    "--folder",
    type=click.Path(path_type=Path, file_okay=False, exists=True),
    default=".",
    show_default="the working directory",
    help="Folder for the key.",
)
@json_option
@readable_errors
def new(name: str, folder: Path, as_json: bool) -> None:
    """Make a key for the peer NAME, and print the table that lets it send commands.

    The key is in NAME.key, which only you may read: copy it to the client's machine over a secure channel, and give
    each client its own key. Without the line `allow` a peer may do what a planner does, and not move the robot. With
    the line `counter` its commands, except Stop, are refused when they are more than 2 s old, and answers to it are
    signed; its clock must be right. Remove the line for a client that does not check answers.

    Exit status: 0 made, 5 it cannot be written, 4 there is such a key, or the name is not valid.

    Example: pcmrs peers new planner --folder ~/keys
    """
    from pcmrs.gateway.commands import DEFAULT
    from pcmrs.gateway.settings import UNIX_NS, GatewayConfig, PeerConfig
    from pcmrs.gateway.signing import new_key

    file = folder.absolute() / f"{name}.key"
    # Refuses the name before there is a file.
    GatewayConfig(peers={name: PeerConfig(key_file=str(file), counter=UNIX_NS)})
    new_key(file)
    if as_json:
        say_json({"peer": name, "key_file": str(file), "allow": DEFAULT, "counter": UNIX_NS})
        return
    say(f"# {file} is made. To your configuration add:")
    say(f"[gateway.peers.{name}]")
    say(f"key_file = {msgspec.json.encode(str(file)).decode()}")
    say(f"allow = {msgspec.json.encode(DEFAULT).decode()}")
    say(f'counter = "{UNIX_NS}"')
