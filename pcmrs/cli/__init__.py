"""The command line `pcmrs`; every command's module is loaded when it is used."""

from __future__ import annotations

from importlib import import_module

import click

COMMANDS = {
    "call": "pcmrs.cli.cell",
    "state": "pcmrs.cli.cell",
    "watch": "pcmrs.cli.cell",
    "keys": "pcmrs.cli.cell",
    "stop": "pcmrs.cli.cell",
    "journal": "pcmrs.cli.journal",
    "experiment": "pcmrs.cli.experiment",
    "demo": "pcmrs.cli.experiment",
    "node": "pcmrs.cli.serve",
    "serve": "pcmrs.cli.serve",
}


class Commands(click.Group):
    """Finds commands by name and imports only the one that is asked for."""

    def list_commands(self, _context: click.Context) -> list[str]:
        return list(COMMANDS)

    def get_command(self, _context: click.Context, name: str) -> click.Command | None:
        if name not in COMMANDS:
            return None
        command: click.Command = getattr(import_module(COMMANDS[name]), name)
        return command


@click.command(cls=Commands, context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(package_name="pcmrs")
def main() -> None:
    """PCMRS: medical robot procedures as hierarchical state machines.

    Start a cell with pcmrs-serve; the commands here talk to it. Research software, not a medical device.
    """
