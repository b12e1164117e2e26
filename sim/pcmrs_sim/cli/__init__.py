"""The command line `pcmrs-sim`: virtual devices that speak the real protocols, without a daemon."""

from __future__ import annotations

import click

from pcmrs.cli.lazy import LazyGroup

COMMANDS = {
    "cell": "pcmrs_sim.cli.commands:cell",
    "kst": "pcmrs_sim.cli.commands:kst",
    "ndi": "pcmrs_sim.cli.commands:ndi",
    "muscle": "pcmrs_sim.lsl.command:muscle",
    "faults": "pcmrs_sim.cli.faults:faults",
}


@click.group(cls=LazyGroup, commands=COMMANDS, context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(package_name="pcmrs")
def main() -> None:
    """Virtual devices that speak the protocols of real ones: KUKA cabinet, tracker, muscle.

    Drivers of real devices connect to them; faults are typed, or scheduled, while they run. Simulated devices only:
    nothing here has been compared with hardware.
    """
