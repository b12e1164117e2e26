"""One simulated world, its virtual devices, and the lines that change it while it runs."""

from __future__ import annotations

import asyncio
import sys
from collections.abc import Callable, Mapping
from contextlib import AbstractAsyncContextManager, AsyncExitStack
from pathlib import Path
from typing import Any

from pcmrs.cli.log import log_to_stderr
from pcmrs.cli.printing import say, say_json
from pcmrs.clock import SystemClock
from pcmrs.errors import DeviceError
from pcmrs_sim.cell import CellSimulation, running_cell
from pcmrs_sim.cli.lines import follow_input, follow_schedule, read_schedule
from pcmrs_sim.cli.terminal import termination

Address = tuple[str, int] | str
"""Host and port, or the path of a pseudo-terminal."""
Servers = Mapping[str, Callable[[CellSimulation], AbstractAsyncContextManager[Address]]]
"""Name of each virtual device to the function that serves it."""


async def serve(
    servers: Servers, settings: Mapping[str, Any], schedule: Path | None, duration: float | None, *, as_json: bool
) -> None:
    """Serve virtual devices until SIGTERM, SIGINT, or the end of a time.

    Args:
        servers: The devices to serve.
        settings: The whole configuration.
        schedule: File of faults; None for none. See `pcmrs_sim.cli.lines.read_schedule`.
        duration: Time after which it ends, s; None for no end.
        as_json: Print the addresses as JSON and not as text.

    Raises:
        ConfigurationError: A setting or a line of the schedule is wrong.
        DeviceError: A port is taken.
    """
    log_to_stderr()
    lines = read_schedule(schedule) if schedule else []
    ended = termination()
    async with AsyncExitStack() as stack:
        cell = await stack.enter_async_context(running_cell(settings, SystemClock()))
        addresses = {}
        for name, server in servers.items():
            addresses[name] = await _enter(stack, name, server(cell))
        if as_json:
            say_json(addresses)
        else:
            say(_text(addresses))
        sys.stdout.flush()
        async with asyncio.TaskGroup() as tasks:
            following = [tasks.create_task(follow_schedule(cell, lines)), tasks.create_task(follow_input(cell))]
            await _wait(ended, duration)
            for task in following:
                task.cancel()


async def _enter(stack: AsyncExitStack, name: str, server: AbstractAsyncContextManager[Address]) -> Address:
    try:
        return await stack.enter_async_context(server)
    except OSError as error:
        text = f"The virtual {name} cannot listen: {error.strerror or error}. Choose another port."
        raise DeviceError(text, device=name) from None


async def _wait(ended: asyncio.Event, duration: float | None) -> None:
    try:
        async with asyncio.timeout(duration):
            await ended.wait()
    except TimeoutError:
        pass  # the requested duration is over


def _text(addresses: Mapping[str, Address]) -> str:
    places = (f"{name} on {at if isinstance(at, str) else f'{at[0]}:{at[1]}'}" for name, at in addresses.items())
    return f"serving {', '.join(places)}"
