"""`pcmrs fsm generate`: the state classes that a daemon runs, for review."""

from __future__ import annotations

from pathlib import Path

import click

from pcmrs.cli.fsm.files import file_argument, output_option, sound, write
from pcmrs.cli.running import readable_errors


@click.command()
@file_argument
@output_option
@readable_errors
def generate(file: str, output: Path | None) -> None:
    """Print the Python source of the branch and state classes of FILE.

    A daemon makes its state objects by executing exactly this text: you review the code that runs.
    """
    from pcmrs.fsm.classes import source_of

    write(source_of(sound(file)), output)
