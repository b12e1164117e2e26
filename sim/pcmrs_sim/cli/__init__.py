"""The command line `pcmrs-sim`: virtual devices that speak the real protocols, without a daemon."""

from __future__ import annotations

import click

from pcmrs.cli.lazy import LazyCommand, LazyGroup

COMMANDS = {
    "cell": LazyCommand("pcmrs_sim.cli.commands:cell"),
    "kst": LazyCommand("pcmrs_sim.cli.commands:kst"),
    "ndi": LazyCommand("pcmrs_sim.cli.commands:ndi"),
    "muscle": LazyCommand("pcmrs_sim.cli.muscle:muscle"),
    "render": LazyCommand("pcmrs_sim.cli.pictures:render"),
    "faults": LazyCommand("pcmrs_sim.cli.commands:faults"),
}


@click.group(cls=LazyGroup, commands=COMMANDS, context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(package_name="pcmrs")
def main() -> None:
    """Virtual devices that speak the protocols of real ones: KUKA cabinet, tracker, muscle.

    Drivers of real devices connect to them. Type or schedule faults while they run. These are simulated devices only:
    nothing here has been compared with hardware.
    """
