"""How long Stop takes while somebody floods the bus, beside the same without a flood and a bare timer.

A daemon of its own, on the simulated cell at real time, and one process that floods as one user who holds no lease.
Stop is pressed from here by UDP, where the answer comes when the robot has confirmed that it stands, and over the bus,
where it comes when the latch is set and the holds are sent. Both are given from the call to the answer.

    .venv/bin/python benchmarks/floods.py [--stops 100] [--kind setup ...] [--json]

Exit status 1: during a flood a Stop by the bus has begun later than 50 ms in its p99, or 100 ms at worst, beyond the
p99 of a bare timer's lateness in the same run; or a Stop was not answered.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import os
import sys
import tempfile
import time
from collections import defaultdict
from contextlib import AsyncExitStack
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import uvloop

from pcmrs.campaign.bus_flood import KINDS, Flooding, Kind, bus_flood
from pcmrs.campaign.driving import register
from pcmrs.campaign.lab import REAL_TIME, LabCell, open_cell
from pcmrs.campaign.lateness import percentile, timer_lateness
from pcmrs.errors import PcmrsError

NONE = "none"
LIMIT_P99, LIMIT_MAX = 0.05, 0.1
"""From a Stop's arrival to its holds during a flood by anybody else, s."""
APART = 0.05
"""Between an answered Stop and the next press, s."""


@dataclass
class Stops:
    """What was measured during one flood.

    Attributes:
        times: Route to the time from the press to its answer, s.
        timer: How late a bare timer was, s.
        unanswered: Presses without an answer.
        flooding: What the other process has done; None without a flood.
    """

    times: dict[str, list[float]] = field(default_factory=lambda: defaultdict(list))
    timer: list[float] = field(default_factory=list)
    unanswered: int = 0
    flooding: Flooding | None = None

    @property
    def kept(self) -> bool:
        """Whether the limits hold for Stops that are answered when they have begun."""
        beside, begun = percentile(self.timer, 0.99), self.times["bus"]
        in_time = percentile(begun, 0.99) - beside <= LIMIT_P99 and max(begun, default=0.0) - beside <= LIMIT_MAX
        return in_time and not self.unanswered


async def stop_during(cell: LabCell, kind: Kind | None, stops: int) -> Stops:
    """Presses Stop so often by each route while a flood of `kind` runs, or none."""
    found = Stops()
    async with AsyncExitStack() as stack:
        if kind is not None:
            flooding = bus_flood(kind, cell.ready.endpoint, cell.name)
            found.flooding = await stack.enter_async_context(flooding)
        timer = await stack.enter_async_context(timer_lateness())
        for _ in range(stops):
            for route, press in (("udp", cell.planner.stop), ("bus", cell.client.stop)):
                begun = time.monotonic()
                try:
                    await press()
                except PcmrsError:
                    found.unanswered += 1
                else:
                    found.times[route].append(time.monotonic() - begun)
                await asyncio.sleep(APART)
        found.timer = timer.late
    return found


async def measure(kinds: list[str], stops: int) -> dict[str, Stops]:
    """Runs one daemon for each kind of flood; returns what was found by kind."""
    found = {}
    for kind in kinds:
        with tempfile.TemporaryDirectory(prefix="pcmrs-", ignore_cleanup_errors=True) as folder:
            async with open_cell(Path(folder) / "flooded", REAL_TIME) as cell:
                await register(cell.client)
                chosen: Kind | None = next((each for each in KINDS if each == kind), None)
                found[kind] = await stop_during(cell, chosen, stops)
    return found


def in_ms(values: list[float]) -> dict[str, float]:
    quantiles = {name: round(percentile(values, share) * 1e3, 2) for name, share in (("p50", 0.5), ("p99", 0.99))}
    return {"n": len(values), **quantiles, "max": round(max(values, default=0.0) * 1e3, 2)}


def report(found: dict[str, Stops]) -> dict[str, Any]:
    return {
        kind: {
            **{f"{route}, ms": in_ms(values) for route, values in each.times.items()},
            "bare timer, ms": in_ms(each.timer),
            "unanswered": each.unanswered,
            "flood, 1/s": 0 if each.flooding is None else round(each.flooding.told.rate),
            "answers": {} if each.flooding is None else each.flooding.told.codes,
        }
        for kind, each in found.items()
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--stops", type=int, default=100)
    parser.add_argument("--kind", action="append", choices=(NONE, *KINDS), default=[])
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    found = uvloop.run(measure(options.kind or [NONE, *KINDS], options.stops))
    values = report(found)
    if options.json:
        print(json.dumps(values, indent=2))
    else:
        print(f"Simulated cell, {os.cpu_count()} processors.")
        for kind, rows in values.items():
            print(kind)
            for name, row in rows.items():
                text = "  ".join(f"{key} {value:g}" for key, value in row.items()) if isinstance(row, dict) else row
                print(f"  {name:<16}{text}")
    if not all(each.kept for kind, each in found.items() if kind != NONE):
        sys.exit(1)


if __name__ == "__main__":
    main()
