"""Errors of commands end in one readable line and an exit status."""

from __future__ import annotations

import asyncio

import click
import pytest
from click.testing import CliRunner

from pcmrs.cli.running import readable_errors, run
from pcmrs.errors import (
    AccessError,
    BlueprintError,
    BusError,
    ConfigurationError,
    JournalError,
    PcmrsError,
    UnknownOutcomeError,
)


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


@pytest.mark.parametrize(
    ("error", "status", "text"),
    [
        (BusError("No daemon."), 3, "failing: No daemon."),
        (ConfigurationError("Wrong key."), 4, "failing: Wrong key."),
        (BlueprintError("Unsound."), 4, "failing: Unsound."),
        (JournalError("Damaged."), 5, "failing: Damaged."),
        (PcmrsError("Something else."), 5, "failing: Something else."),
        (FileNotFoundError(2, "No such file", "a.csv"), 5, "failing: a.csv: No such file"),
        (UnknownOutcomeError("Silent."), 6, "failing: Silent."),
        (AccessError("A viewer."), 1, "failing: A viewer."),
        (ModuleNotFoundError("", name="mcap"), 4, "install the extra"),
        (KeyboardInterrupt(), 130, ""),
    ],
    ids=lambda value: type(value).__name__ if isinstance(value, BaseException) else "",
)
def test_each_error_has_its_exit_status_and_one_line(error: BaseException, status: int, text: str) -> None:
    @click.command()
    @readable_errors
    def failing() -> None:
        raise error

    ended = CliRunner().invoke(failing)
    assert (ended.exit_code, ended.stdout) == (status, "")
    assert text in ended.stderr
    assert len(ended.stderr.splitlines()) == bool(text)


def test_a_module_of_no_extra_is_a_defect_and_not_hidden() -> None:
    @click.command()
    @readable_errors
    def failing() -> None:
        raise ModuleNotFoundError("No module named 'nothing'", name="nothing")

    assert isinstance(CliRunner().invoke(failing).exception, ModuleNotFoundError)


def test_what_runs_returns_its_value_and_its_loop_is_closed() -> None:
    async def work() -> tuple[int, asyncio.AbstractEventLoop]:
        return 7, asyncio.get_running_loop()

    value, loop = run(work())
    assert value == 7
    assert loop.is_closed()
