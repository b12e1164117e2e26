"""Errors of commands end in one readable line and an exit status."""

from __future__ import annotations

import click
from click.testing import CliRunner

from pcmrs.cli.running import readable_errors
from pcmrs.errors import PcmrsError


def test_lines_of_an_error_cannot_pass_for_a_message() -> None:
    """A table in an error can be copied; a line break in a value from outside begins no line of PCMRS."""

    @click.command()
    @readable_errors
    def failing() -> None:
        raise PcmrsError("Add this:\n\n[[migrations]]\nhash = '1'\npcmrs: all is well\x1b[2J")

    ended = CliRunner().invoke(failing)
    assert ended.stderr.splitlines() == [
        "failing: Add this:",
        "",
        "  [[migrations]]",
        "  hash = '1'",
        "  pcmrs: all is well\\u001b[2J",
    ]
