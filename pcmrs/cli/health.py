"""`pcmrs health`: how the daemon of a cell is, why it is not well, and what to do."""

from __future__ import annotations

import sys
from collections.abc import AsyncIterator

import click
from rich.live import Live

from pcmrs.cli.health_table import health_table
from pcmrs.cli.options import Address, address_options, json_option
from pcmrs.cli.printing import NARROWEST, Terminal, say_json
from pcmrs.cli.running import EXIT_REJECTED, readable_errors, run
from pcmrs.clock import SystemClock
from pcmrs.messages.health import Health

WATCHING = 1.0
"""Between two looks at a daemon that is watched, s."""


@click.command()
@click.option("--watch", is_flag=True, help="Look again every second, until interrupted.")
@json_option
@address_options
@readable_errors
def health(watch: bool, as_json: bool, address: Address) -> None:
    """Print how the daemon is, why it is not well, and what to do.

    Exit status: 0 ok, 1 degraded or failed, 2 it fell silent, 3 no daemon.
    """
    if watch:
        run(_watch(address, as_json=as_json))
        return
    found = run(_health(address))
    if as_json:
        _print_json(found)
    else:
        _console().print(health_table(found))
    if found.status != "ok":
        sys.exit(EXIT_REJECTED)


async def _health(address: Address) -> Health:
    async with address.connect() as client:
        return await client.health()


async def _watch(address: Address, *, as_json: bool) -> None:
    if as_json:
        async for found in _looks(address):
            _print_json(found)
        return
    with Live(console=_console(), auto_refresh=False) as live:
        async for found in _looks(address):
            live.update(health_table(found), refresh=True)


async def _looks(address: Address) -> AsyncIterator[Health]:
    clock = SystemClock()
    async with address.connect() as client:
        while True:
            yield await client.health()
            await clock.sleep(WATCHING)


def _print_json(found: Health) -> None:
    say_json(found)


def _console() -> Terminal:
    return Terminal(width=max(Terminal().width, NARROWEST), highlight=False)
