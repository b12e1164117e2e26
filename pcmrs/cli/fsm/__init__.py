"""`pcmrs fsm`: design, verification, drawing and tests of workflows."""

from __future__ import annotations

import click

from pcmrs.cli.lazy import LABORATORY, LazyGroup

COMMANDS = {
    "design": "pcmrs.cli.fsm.design:design",
    "verify": "pcmrs.cli.fsm.verify:verify",
    "generate": "pcmrs.cli.fsm.generate:generate",
    "render": "pcmrs.cli.fsm.render:render",
    "export": "pcmrs.cli.fsm.export:export",
    "import": "pcmrs.cli.fsm.import_:import_",
    "simulate": "pcmrs.cli.fsm.simulate:simulate",
    "test": LABORATORY,
    "diff": "pcmrs.cli.fsm.diff:diff",
}


@click.group(cls=LazyGroup, commands=COMMANDS, prefix="fsm.")
def fsm() -> None:
    """Design, verify, draw, import, test and compare workflows.

    FILE is a blueprint, the name of an installed workflow such as ratms, or - for standard input. Exit status:
    0 sound or done, 1 unsound or different, 2 unreadable or impossible.
    """
