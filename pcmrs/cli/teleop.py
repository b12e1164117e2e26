"""`pcmrs teleop`: guides the tool by hand, from anywhere that reaches the cell's bus."""

from __future__ import annotations

import math
import sys
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager, nullcontext
from pathlib import Path

import click
import msgspec
from rich.console import Group
from rich.live import Live

from pcmrs.background import background_task
from pcmrs.cli.options import CellAddress, address_options, json_option
from pcmrs.cli.printing import say, say_json
from pcmrs.cli.running import EXIT_FAILED, EXIT_REJECTED, readable_errors, run
from pcmrs.cli.tables import Terminal, styled
from pcmrs.client import Client
from pcmrs.clock import SystemClock
from pcmrs.errors import CommandRefusedError
from pcmrs.messages import TeleopStatus, Verdict
from pcmrs.teleop.demand import Mapping
from pcmrs.teleop.devices import DEVICES, open_device
from pcmrs.teleop.keyboard import HELP
from pcmrs.teleop.session import Report, TeleopSession

LIMITS = {
    "height": "at the planned contact",
    "range": "as far as allowed",
    "turn": "turned as far as allowed",
    "zone": "too near to a zone",
    "reach": "at the end of a joint",
}


def status_line(status: TeleopStatus | None) -> str:
    """Return the newest status; None before the first."""
    return ", ".join(_parts(status)) if status is not None else "waiting for the cell"


def report_line(report: Report) -> str:
    """Return a refusal, or a danger, as a line."""
    if isinstance(report, Verdict):
        why = report.reason.text if report.reason is not None else "no reason"
        return f"{report.branch}.{report.operation} was {report.decision}: {why}"
    return f"{report.code}: {report.text}"


def _parts(status: TeleopStatus) -> list[str]:
    parts = ["clutch open" if status.user is None else f"engaged by {status.user}"]
    if status.round_trip is not None and status.jitter is not None:
        parts.append(f"{status.round_trip * 1000:.0f} ms ± {status.jitter * 1000:.0f}")
        parts.append("held: too late, release the clutch once" if status.held else f"speed {status.scale * 100:.0f} %")
    if status.distance is not None and status.height is not None and status.turn is not None:
        distance_mm, height_mm = status.distance * 1000, status.height * 1000
        parts.append(
            f"{distance_mm:.1f} mm and {math.degrees(status.turn):.1f}° from the plan, {height_mm:.1f} mm above"
        )
    if status.limit is not None:
        parts.append(LIMITS[status.limit])
    if status.refused:
        parts.append(f"{sum(status.refused.values())} refused")
    return parts


SHOW_EVERY = 0.1
"""Period of the displayed status, s."""


@click.command()
@click.option(
    "--device",
    type=click.Choice(DEVICES),
    default="keyboard",
    show_default=True,
    help="Input device, or a script in its place.",
)
@click.option(
    "--script",
    type=click.Path(path_type=Path, dir_okay=False, exists=True),
    metavar="FILE",
    help="Script for --device script: lines of a time and a twist, s, m/s and rad/s.",
)
@click.option("--rate", type=click.FloatRange(20, 200), default=50, show_default=True, help="Set points per second.")
@click.option("--linear", type=click.FloatRange(0.001, 0.1), default=0.01, show_default=True, help="Full speed, m/s.")
@click.option(
    "--angular", type=click.FloatRange(0.01, 1), default=0.1, show_default=True, help="Full angular speed, rad/s."
)
@json_option
@address_options
@readable_errors
def teleop(
    device: str, script: Path | None, rate: float, linear: float, angular: float, as_json: bool, address: CellAddress
) -> None:
    """Guide the tool near its planned pose, for as long as the clutch is held.

    You hold the cell meanwhile. The tool must be at the standoff or at its place. It moves along its own axes, +z
    away from the body. The cell limits its speed, the more so the later the set points arrive, and holds the tool if
    they no longer arrive: then someone at the cell decides how to continue.

    Exit status: 0 left, 1 not allowed, 5 ended by the cell or its silence, 3 no daemon.
    """
    if (device == "script") != (script is not None):
        raise click.UsageError("--device script and --script FILE need each other.")
    try:
        ended = run(_teleoperate(address, device, script, Mapping(linear, angular), rate, as_json))
    except CommandRefusedError as error:
        say(error.text, err=True)
        sys.exit(EXIT_REJECTED)
    if ended:
        say(ended, err=True)
        sys.exit(EXIT_FAILED)


async def _teleoperate(
    address: CellAddress, device: str, script: Path | None, mapping: Mapping, rate: float, as_json: bool
) -> str:
    def show(report: Report) -> None:
        say(msgspec.json.encode(report).decode() if as_json else report_line(report), err=not as_json)

    async with address.connect() as client, _holding_cell(client):
        with open_device(device, mapping, script) as hands:
            session = TeleopSession(client, hands, SystemClock(), rate, show)
            showing = _print_json(session) if as_json else _show_status_line(session, keys=device == "keyboard")
            async with background_task(showing):
                return await session.run()


@asynccontextmanager
async def _holding_cell(client: Client) -> AsyncIterator[None]:
    """Hold the cell, unless this client does already.

    Raises:
        CommandRefusedError: Another user holds it.
    """
    lease = (await client.state()).lease
    async with nullcontext() if lease is not None and lease.holder == client.user else client.holding():
        yield


async def _print_json(session: TeleopSession) -> None:
    while True:
        if session.status is not None:
            say_json(session.status)
        await SystemClock().sleep(SHOW_EVERY)


async def _show_status_line(session: TeleopSession, *, keys: bool) -> None:
    help_line = [styled(HELP, style="dim")] if keys else []
    with Live(console=Terminal(stderr=True, highlight=False), auto_refresh=False, transient=True) as live:
        while True:
            live.update(Group(status_line(session.status), *help_line), refresh=True)
            await SystemClock().sleep(SHOW_EVERY)
