"""`pcmrs lease`: shows and changes the holder of a cell; commands of others are refused."""

from __future__ import annotations

import asyncio
import signal
import sys

import click

from pcmrs.cli.cell import STATUS, event_line
from pcmrs.cli.lazy import LazyCommand, LazyGroup
from pcmrs.cli.options import CellAddress, address_options, json_option
from pcmrs.cli.printing import say, say_json
from pcmrs.cli.running import EXIT_FAILED, EXIT_REJECTED, fail, readable_errors, run
from pcmrs.errors import CommandRefusedError
from pcmrs.messages import LeaseState, Verdict

COMMANDS = {name: LazyCommand(f"pcmrs.cli.lease:{name}") for name in ("show", "take", "hold", "confirm", "release")}

over_option = click.option(
    "--over", is_flag=True, help="Take it over from its holder: at once on site, otherwise when they confirm."
)


@click.group(cls=LazyGroup, commands=COMMANDS)
def lease() -> None:
    """Hold a cell: one operator or teleoperator at a time gives commands, and planners may plan for them.

    A cell that other machines can reach accepts no command that moves or changes anything while nobody holds it.
    Stop needs no lease.
    """


@click.command()
@json_option
@address_options
@readable_errors
def show(as_json: bool, address: CellAddress) -> None:
    """Print the holder of the cell, and the user who requests it."""
    found = run(_shown(address))
    if as_json:
        say_json(found)
    elif found is None:
        say("nobody holds it")
    else:
        say(f"{found.holder} holds it" + (f"; {found.asking} asks for it" if found.asking else ""))


@click.command()
@over_option
@json_option
@address_options
@readable_errors
def take(over: bool, as_json: bool, address: CellAddress) -> None:
    """Take the lease: on site until it is released; from elsewhere it lapses unless it is renewed, see `hold`.

    Exit status: 0 taken or asked for, 1 refused, 3 no daemon.
    """
    _end_with(run(_call(address, "take_over" if over else "acquire")), as_json=as_json)


@click.command()
@over_option
@address_options
@readable_errors
def hold(over: bool, address: CellAddress) -> None:
    """Hold the cell until interrupted, and release it then.

    Exit status: 0 released, 1 refused, 5 lost in between, 3 no daemon.

    Example: pcmrs lease hold --endpoint tls/router.example.org:7449 --identity anna
    """
    run(_hold(address, over=over))


@click.command()
@click.argument("user")
@json_option
@address_options
@readable_errors
def confirm(user: str, as_json: bool, address: CellAddress) -> None:
    """Hand the cell over to USER, who has asked for it; all motion is stopped first.

    Exit status: 0 handed over, 1 refused, 3 no daemon.
    """
    _end_with(run(_call(address, "confirm", user=user)), as_json=as_json)


@click.command()
@json_option
@address_options
@readable_errors
def release(as_json: bool, address: CellAddress) -> None:
    """Release the cell; all motion is stopped.

    Exit status: 0 released, 1 refused, 3 no daemon.
    """
    _end_with(run(_call(address, "release")), as_json=as_json)


async def _shown(address: CellAddress) -> LeaseState | None:
    async with address.connect() as client:
        return (await client.state()).lease


async def _call(address: CellAddress, operation: str, **arguments: str) -> Verdict:
    async with address.connect() as client:
        return await client.call(f"lease.{operation}", arguments)


async def _hold(address: CellAddress, *, over: bool) -> None:
    loop, ended = asyncio.get_running_loop(), asyncio.Event()
    for number in (signal.SIGTERM, signal.SIGINT):
        loop.add_signal_handler(number, ended.set)
    status = EXIT_REJECTED
    try:
        async with address.connect() as client, client.holding(over=over):
            status = EXIT_FAILED
            say("held; interrupt to release it")
            sys.stdout.flush()
            await ended.wait()
    except CommandRefusedError as error:
        fail(error, status)


def _end_with(verdict: Verdict, *, as_json: bool) -> None:
    if as_json:
        say_json(verdict)
    else:
        say(event_line(verdict))
    sys.exit(STATUS[verdict.decision])
