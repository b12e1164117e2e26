"""`pcmrs faults`: the fault campaign and its tools."""

from __future__ import annotations

import click

from pcmrs.cli.lazy import LazyGroup

COMMANDS = {
    "list": "pcmrs_lab.cli.faults.list:list_",
    "matrix": "pcmrs_lab.cli.faults.matrix:matrix",
    "run": "pcmrs_lab.cli.faults.run:run_",
    "kill": "pcmrs_lab.cli.faults.kill:kill",
    "cut": "pcmrs_lab.cli.faults.cut:cut",
    "fuzz": "pcmrs_lab.cli.faults.fuzz:fuzz",
    "soak": "pcmrs_lab.cli.faults.soak:soak",
    "explore": "pcmrs_lab.cli.faults.explore:explore",
}


@click.group(cls=LazyGroup, commands=COMMANDS)
def faults() -> None:
    """Inject faults into simulated cells, and check that nothing is lost and nothing moves by itself.

    Every command starts its own daemons; a running cell is never touched. Exit status of all commands: 0 every response
    was as required, 1 one was not, 2 wrong usage or the command could not be carried out, 4 a workflow or script cannot
    be used, 130 after Ctrl-C.
    """
