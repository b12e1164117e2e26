"""`pcmrs lease` asks for the operation of the lease that it names, and ends with the daemon's decision."""

from __future__ import annotations

import asyncio
import json
import sys
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

import msgspec
import pytest
from click.testing import Result

from pcmrs.bus import CommandEdge
from pcmrs.messages import Command, Reason, Snapshot, Verdict
from pcmrs.messages._snapshot import LeaseState
from tests.unit.bus.bus_cells import accepted, new_cell, open_bus, snapshot
from tests.unit.cli.command_line import run
from tests.unit.client.small_daemon import Daemon


class Holding(Daemon):
    """A daemon with a lease, which refuses all commands if it is told to."""

    lease: LeaseState | None = None
    refuses = False

    async def submit(self, command: Command, *, arrived: float | None) -> Verdict:
        self.commands.append(command)
        if not self.refuses:
            return accepted(command)
        reason = Reason(code="held", text="anna holds the cell.")
        return msgspec.structs.replace(accepted(command), decision="rejected", reason=reason)

    async def snapshot(self, _: str, __: object) -> Snapshot:
        return msgspec.structs.replace(snapshot(1), lease=self.lease)


@asynccontextmanager
async def daemon() -> AsyncIterator[Holding]:
    async with open_bus(new_cell()) as bus:
        held = Holding(bus)
        edge = await CommandEdge.open(bus, held.submit, lambda *_: None, held.stop)
        yield held
        await edge.close()


async def lease(on: Holding, *words: str) -> Result:
    settings = on.bus.settings
    address = ("--endpoint", settings.endpoint, "--site", settings.site, "--cell", settings.cell)
    return await asyncio.to_thread(run, "lease", *words, *address)


@pytest.mark.parametrize(
    ("words", "operation", "arguments"),
    [
        (("take",), "acquire", {}),
        (("take", "--over"), "take_over", {}),
        (("confirm", "ben"), "confirm", {"user": "ben"}),
        (("release",), "release", {}),
    ],
)
async def test_each_command_is_an_operation_of_the_lease(
    words: tuple[str, ...], operation: str, arguments: dict[str, str]
) -> None:
    async with daemon() as held:
        assert (await lease(held, *words)).exit_code == 0
        (command,) = held.commands
        assert (command.branch, command.operation, command.arguments) == ("lease", operation, arguments)


async def test_a_refused_lease_ends_with_1_and_the_reason() -> None:
    async with daemon() as held:
        held.refuses = True
        ended = await lease(held, "take")
        assert ended.exit_code == 1
        assert "anna holds the cell." in ended.stdout


async def test_hold_that_is_refused_ends_with_1_and_the_reason() -> None:
    async with daemon() as held:
        held.refuses = True
        settings = held.bus.settings
        address = ("--endpoint", settings.endpoint, "--site", settings.site, "--cell", settings.cell)
        command = (sys.executable, "-m", "pcmrs.cli", "lease", "hold", *address)
        process = await asyncio.create_subprocess_exec(*command, stderr=asyncio.subprocess.PIPE)
        _, said = await process.communicate()
        assert process.returncode == 1
        assert b"anna holds the cell." in said


async def test_the_holder_is_shown_with_who_asks_for_it() -> None:
    async with daemon() as held:
        assert (await lease(held, "show")).stdout == "nobody holds it\n"
        held.lease = LeaseState(holder="anna", asking="ben")
        assert (await lease(held, "show")).stdout == "anna holds it; ben asks for it\n"
        assert json.loads((await lease(held, "show", "--json")).stdout) == {"holder": "anna", "asking": "ben"}
