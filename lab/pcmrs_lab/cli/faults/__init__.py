"""`pcmrs faults`: the fault campaign and its tools."""

from __future__ import annotations

import click

from pcmrs.cli.lazy import LazyCommand, LazyGroup

COMMANDS = {
    "list": LazyCommand(
        "pcmrs_lab.cli.faults.list:list_",
        "List the faults of the catalogue: the required response, how each is injected, and what that needs.",
    ),
    "matrix": LazyCommand(
        "pcmrs_lab.cli.faults.matrix:matrix",
        "Print which attackers were tested on which entry points, with the catalogue rows and tests that prove it.",
    ),
    "run": LazyCommand(
        "pcmrs_lab.cli.faults.run:run_",
        "Inject faults into separate simulated cells, and check that each response is the required one.",
    ),
    "kill": LazyCommand(
        "pcmrs_lab.cli.faults.kill:kill",
        "Kill processes with SIGKILL, at every failpoint and at random instants; nothing acknowledged may be lost.",
    ),
    "cut": LazyCommand(
        "pcmrs_lab.cli.faults.cut:cut",
        "Damage copies of a journal and open them: a loss must be reported, never silent; "
        "power cuts must lose nothing.",
    ),
    "fuzz": LazyCommand(
        "pcmrs_lab.cli.faults.fuzz:fuzz",
        "Send fuzzed datagrams to a daemon: it must not crash, change its state, or grow by 10 MB.",
    ),
    "soak": LazyCommand(
        "pcmrs_lab.cli.faults.soak:soak",
        "Operate a simulated cell at random for hours: memory, file descriptors, threads and tasks must stay flat.",
    ),
    "explore": LazyCommand(
        "pcmrs_lab.cli.faults.explore:explore",
        "Run random procedures under random faults, and check the invariants after every event.",
    ),
}


@click.group(cls=LazyGroup, commands=COMMANDS)
def faults() -> None:
    """Inject faults into simulated cells, and check that nothing is lost and nothing moves by itself.

    Every command starts its own daemons; a running cell is never touched. Exit status of all commands: 0 every response
    was as required, 1 one was not, 2 wrong usage or the command could not be carried out, 4 a workflow or script cannot
    be used, 130 after Ctrl-C.
    """
