"""`pcmrs cells`: every connected cell is listed, with what its daemon says, or that there is none."""

from __future__ import annotations

import asyncio
import json

import msgspec

from pcmrs.bus import Bus, Empty
from pcmrs.messages import Snapshot
from pcmrs.messages._snapshot import LeaseState
from tests.unit.bus.bus_cells import new_cell, open_bus, snapshot
from tests.unit.cli.command_line import run


def serve_state(bus: Bus, shown: Snapshot) -> None:
    async def answer(_key: str, _asked: Empty) -> Snapshot:
        return shown

    bus.serve("svc/snapshot", Empty, answer)


async def test_each_cell_is_listed_with_its_state() -> None:
    router = new_cell()
    others = [msgspec.structs.replace(router, mode="client", cell=name) for name in ("alone", "silent")]
    held = msgspec.structs.replace(snapshot(1), latched=True, lease=LeaseState(holder="anna"))
    async with open_bus(router) as first, open_bus(others[0]) as alone, open_bus(others[1]) as silent:
        serve_state(first, held)
        first.alive("daemon")
        first.alive("robot")
        alone.alive("console")
        silent.alive("daemon")
        ended = await asyncio.to_thread(run, "cells", "--json", "--endpoint", router.endpoint)
    assert ended.exit_code == 0, ended.output
    found = {each.pop("cell"): each for each in json.loads(ended.stdout)}
    nothing = {"latched": "", "holder": ""}
    assert found == {
        f"test/{router.cell}": {
            "components": ["daemon", "robot"],
            "workflow": "test 1",
            "latched": "yes",
            "holder": "anna",
        },
        "test/alone": {"components": ["console"], "workflow": "no daemon", **nothing},
        "test/silent": {"components": ["daemon"], "workflow": "does not answer", **nothing},
    }


async def test_a_router_without_cells_has_an_empty_list() -> None:
    router = new_cell()
    async with open_bus(router):
        ended = await asyncio.to_thread(run, "cells", "--json", "--endpoint", router.endpoint)
    assert (ended.exit_code, json.loads(ended.stdout)) == (0, [])
