"""`pcmrs data`: the data of a procedure in the files of other software."""

from __future__ import annotations

import click

from pcmrs.cli.lazy import LazyCommand, LazyGroup

COMMANDS = {
    "export": LazyCommand(
        "pcmrs.cli.data.export:export",
        "Write the calibrations and the last procedure of the configured cell as the files of other software.",
    ),
}


@click.group(cls=LazyGroup, commands=COMMANDS)
def data() -> None:
    """Export the data of a procedure for other software."""
