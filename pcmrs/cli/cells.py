"""`pcmrs cells`: every cell that can be reached, and its state."""

from __future__ import annotations

import asyncio
from dataclasses import replace
from typing import Any

import click
from rich.table import Table

from pcmrs.bus import BusSettings
from pcmrs.bus.cells import find_cells
from pcmrs.cli.options import CellAddress, address_options, json_option
from pcmrs.cli.printing import say_json
from pcmrs.cli.running import readable_errors, run
from pcmrs.cli.tables import Terminal
from pcmrs.errors import PcmrsError
from pcmrs.messages import Snapshot

DAEMON = "daemon"


@click.command()
@json_option
@address_options
@readable_errors
def cells(as_json: bool, address: CellAddress) -> None:
    """List the connected cells in which you have a role; on a router, those of all sites.

    --site and --cell have no effect.

    Example: pcmrs cells --endpoint tls/router.example.org:7449 --identity anna
    """
    found = run(_cells(address))
    if as_json:
        say_json(found)
        return
    table = Table("cell", "workflow", "latched", "held by", "connected")
    for each in found:
        table.add_row(each["cell"], each["workflow"], each["latched"], each["holder"], " ".join(each["components"]))
    Terminal().print(table)


async def _cells(address: CellAddress) -> list[dict[str, Any]]:
    settings = BusSettings(endpoint=address.endpoint, credentials=address.credentials())
    found = await find_cells(settings)
    return await asyncio.gather(*(_shown(address, *each) for each in found.items()))


async def _shown(address: CellAddress, name: str, components: list[str]) -> dict[str, Any]:
    site, cell = name.split("/")
    shown = {"cell": name, "components": components, "workflow": "", "latched": "", "holder": ""}
    if DAEMON not in components:
        return shown | {"workflow": "no daemon"}
    try:
        async with replace(address, site=site, cell=cell).connect() as client:
            return shown | _of(await client.state())
    except PcmrsError:
        return shown | {"workflow": "does not answer"}


def _of(snapshot: Snapshot) -> dict[str, str]:
    return {
        "workflow": f"{snapshot.blueprint.id} {snapshot.blueprint.version}",
        "latched": "yes" if snapshot.latched else "no",
        "holder": snapshot.lease.holder if snapshot.lease is not None else "",
    }
