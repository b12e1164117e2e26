"""`pcmrs health`: the health of a cell's daemon, reasons for problems, and what to do."""

from __future__ import annotations

import sys
from collections.abc import AsyncIterator, Mapping

import click
from rich.box import SIMPLE_HEAD
from rich.console import Group, RenderableType
from rich.live import Live
from rich.table import Table

from pcmrs.cli.options import CellAddress, address_options, json_option
from pcmrs.cli.printing import say_json
from pcmrs.cli.running import EXIT_REJECTED, readable_errors, run
from pcmrs.cli.tables import NARROWEST, Terminal, styled
from pcmrs.clock import SystemClock
from pcmrs.messages.health import Health, LatencyStatus

COLOURS = {"ok": "green", "degraded": "yellow", "failed": "red"}


def health_table(health: Health) -> Group:
    """Return the verdict and its reasons, then the details."""
    shown: list[RenderableType] = [styled(_title(health), style=f"bold {COLOURS[health.status]}")]
    for reason in health.reasons:
        shown += [f"{reason.severity}: {reason.code}: {reason.text}", f"  → {reason.remedy}"]
    return Group(*shown, _overview(health), _devices(health), _tasks(health))


def _title(health: Health) -> str:
    tag = health.blueprint
    return (
        f"{health.status}: {tag.id} {tag.version} ({tag.hash[:12]}), pcmrs {health.versions['pcmrs']}, "
        f"up {_duration(health.uptime)}"
    )


def _overview(health: Health) -> Table:
    table = Table(box=SIMPLE_HEAD, show_header=False)
    table.add_column(no_wrap=True)
    table.add_column(overflow="fold")
    journal, loop = health.journal, health.loop
    rejected = f"; rejected for {_listed(health.rejections)}" if health.rejections else ""
    table.add_row("stop", "latched" if health.latched else "not latched")
    table.add_row("decisions", _listed(health.decisions) + rejected)
    for latency in health.latencies:
        table.add_row(f"until {latency.decision}", _latency(latency))
    waiting = f"{journal.waiting} rows wait, the oldest for {journal.oldest_wait:.3f} s"
    table.add_row("journal", journal.failure or waiting)
    if journal.free is not None:
        table.add_row("disk", f"{journal.free / 1e9:.1f} GB free")
    table.add_row("loop", f"{loop.lag:.3f} s late, {loop.stalls} stalls, the longest {loop.longest:.2f} s")
    queues = ", ".join(f"{each.queue} {each.depth} of {each.limit}" for each in health.queues)
    table.add_row("queues", queues)
    refused = {each.queue: each.refused or 0 for each in health.queues}
    table.add_row("dropped", _listed({name: many for name, many in (refused | health.dropped).items() if many}))
    return table


def _devices(health: Health) -> Table:
    table = Table(box=SIMPLE_HEAD)
    for name in ("device", "connected", "heard s ago", "data s ago", "dropped", "node", "restarts"):
        table.add_column(name, no_wrap=True)
    nodes = {device: node for node in health.nodes for device in node.devices}
    for each in health.devices:
        node = nodes.get(each.device)
        table.add_row(
            each.device,
            "yes" if each.connected else "NO",
            _age(each.heard),
            _age(each.data),
            _listed(each.dropped),
            "elsewhere" if node is None else node.driver + (" GIVEN UP" if node.given_up else ""),
            "" if node is None else str(node.restarts),
        )
    return table


def _tasks(health: Health) -> Table:
    table = Table(box=SIMPLE_HEAD)
    for name in ("task", "answers", "restarts"):
        table.add_column(name, no_wrap=True)
    for task in health.tasks:
        table.add_row(task.name, "yes" if task.answers else "NO", str(task.restarts))
    return table


def _latency(latency: LatencyStatus) -> str:
    return f"{latency.count} commands: p50 {latency.p50 * 1000:.1f} ms, p99 {latency.p99 * 1000:.1f} ms"


def _listed(many: Mapping[str, int]) -> str:
    return ", ".join(f"{name} {count}" for name, count in many.items()) or "none"


def _age(seconds: float | None) -> str:
    return "-" if seconds is None else f"{seconds:.3f}"


def _duration(seconds: float) -> str:
    minutes, rest = divmod(int(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02}:{rest:02}"


WATCHING = 1.0
"""Period of --watch, s."""


@click.command()
@click.option("--watch", is_flag=True, help="Print it every second, until interrupted.")
@json_option
@address_options
@readable_errors
def health(watch: bool, as_json: bool, address: CellAddress) -> None:
    """Print the health of the daemon, the reasons for problems, and what to do.

    Exit status: 0 ok, 1 degraded or failed, 5 it stopped answering, 3 no daemon.
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


async def _health(address: CellAddress) -> Health:
    async with address.connect() as client:
        return await client.health()


async def _watch(address: CellAddress, *, as_json: bool) -> None:
    if as_json:
        async for found in _looks(address):
            _print_json(found)
        return
    with Live(console=_console(), auto_refresh=False) as live:
        async for found in _looks(address):
            live.update(health_table(found), refresh=True)


async def _looks(address: CellAddress) -> AsyncIterator[Health]:
    clock = SystemClock()
    async with address.connect() as client:
        while True:
            yield await client.health()
            await clock.sleep(WATCHING)


def _print_json(found: Health) -> None:
    say_json(found)


def _console() -> Terminal:
    return Terminal(width=max(Terminal().width, NARROWEST), highlight=False)
