"""The numbers of the fault campaign: faults, kills, power cuts, simulated sessions, and Stop under a flood.

All on simulated cells. Ratios and counts, not absolute claims: every time is printed beside a bare timer's lateness in
the same run, which is what the machine's scheduler adds. In full it takes hours; the options scale each part down, and
0 leaves it out.

    .venv/bin/python benchmarks/reliability.py [--seeds 3] [--kills 10000] [--daemons 200] [--power 1000]
        [--sessions-minutes 60] [--stops 1000] [--datagrams 1000000] [--json]
"""

from __future__ import annotations

import argparse
import asyncio
import json
import platform
import subprocess
import sys
import tempfile
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import msgspec

from pcmrs.campaign.catalogue import choose
from pcmrs.campaign.cuts import cut_power
from pcmrs.campaign.daemonkills import kill_daemons
from pcmrs.campaign.faults.adversary import FLOOD, stop_times
from pcmrs.campaign.flood import flood
from pcmrs.campaign.fuzz import fuzz
from pcmrs.campaign.kills import kill_writers
from pcmrs.campaign.lab import open_cell
from pcmrs.campaign.lateness import percentile, timer_lateness
from pcmrs.campaign.run import run_campaign
from pcmrs.clock import SystemClock

CLOCK = SystemClock()
SEED = 1


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=3, help="every fault of the catalogue so many times")
    parser.add_argument("--kills", type=int, default=10_000, help="kills of a process that writes the journal")
    parser.add_argument("--daemons", type=int, default=200, help="kills of the daemon in operation")
    parser.add_argument("--power", type=int, default=1_000, help="power cuts")
    parser.add_argument("--sessions-minutes", type=float, default=60.0, help="minutes of simulated sessions")
    parser.add_argument("--stops", type=int, default=1_000, help="Stops under a flood, and as many without")
    parser.add_argument("--datagrams", type=int, default=1_000_000, help="fuzzed datagrams")
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--json", action="store_true")
    given = parser.parse_args()
    found: dict[str, Any] = {"machine": platform.platform(), "python": platform.python_version(), "simulated": True}
    for name, measure in _parts(given).items():
        found[name] = measure()
        if not given.json:
            print(f"{name}: {json.dumps(found[name])}", flush=True)
    if given.json:
        print(json.dumps(found))


def _parts(given: argparse.Namespace) -> dict[str, Callable[[], dict[str, Any]]]:
    """What is to be measured, in this order."""
    parts: dict[str, tuple[float, Callable[[], dict[str, Any]]]] = {
        "kills of a journal writer": (given.kills, lambda: _fields(kill_writers(given.kills, SEED, CLOCK))),
        "power cuts": (given.power, lambda: _fields(cut_power(given.power, SEED, CLOCK))),
        "kills of a daemon": (
            given.daemons,
            lambda: _fields(asyncio.run(kill_daemons(given.daemons, SEED, CLOCK))),
        ),
        "Stop": (given.stops, lambda: asyncio.run(_stops(given.stops))),
        "fuzzed datagrams": (given.datagrams, lambda: asyncio.run(_fuzzed(given.datagrams))),
        "simulated sessions": (given.sessions_minutes, lambda: _explored(given.sessions_minutes, given.jobs)),
        "catalogue": (given.seeds, lambda: asyncio.run(_catalogue(given.seeds, given.jobs))),
    }
    return {name: measure for name, (amount, measure) in parts.items() if amount}


def _fields(report: msgspec.Struct) -> dict[str, Any]:
    fields: dict[str, Any] = msgspec.to_builtins(report)
    return fields


async def _catalogue(seeds: int, jobs: int) -> dict[str, Any]:
    report = await run_campaign([row for row in choose() if not row.access_control], range(1, seeds + 1), jobs)
    outcomes = Counter[str](result.outcome for result in report.faults)
    rest = {f"{each.id} seed {each.seed}": each.response for each in report.faults if each.outcome != "passed"}
    return {"faults": len(report.faults), **outcomes, "seconds": report.seconds, "not passed": rest}


async def _stops(stops: int) -> dict[str, Any]:
    """Time until the daemon has begun to stop, over the bus, beside a bare timer; at rest and under a flood."""
    found: dict[str, Any] = {}
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder:
        async with open_cell(Path(folder) / "cell", ("robot.deadman=0.5",)) as cell:
            async with timer_lateness() as timer:
                found["at rest"] = _in_ms(await stop_times(cell, stops), timer.late)
            async with flood(cell.ready.links["planner"], FLOOD, SEED) as sent, timer_lateness() as timer:
                found["under a flood"] = _in_ms(await stop_times(cell, stops), timer.late)
            found["datagrams_per_second"] = round(sent.rate)
    return found


def _in_ms(stops: list[float], timer: list[float]) -> dict[str, float]:
    shares = {"p50": 0.5, "p99": 0.99, "p99.9": 0.999, "max": 1.0}
    return {
        f"{what} {name} ms": round(percentile(values, share) * 1e3, 2)
        for what, values in (("stop", stops), ("timer", timer))
        for name, share in shares.items()
    }


async def _fuzzed(datagrams: int) -> dict[str, Any]:
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder:
        return _fields(await fuzz(datagrams, SEED, Path(folder), CLOCK))


def _explored(minutes: float, jobs: int) -> dict[str, Any]:
    """Sessions in simulated time, by the command that explores them."""
    words = ["--sessions", "1000000", "--minutes", str(minutes), "--jobs", str(jobs), "--seed", str(SEED), "--json"]
    run = subprocess.run(
        [sys.executable, "-m", "pcmrs.cli", "faults", "explore", *words], capture_output=True, text=True, check=False
    )
    try:
        found: dict[str, Any] = json.loads(run.stdout)
    except ValueError:
        return {"status": run.returncode, "error": run.stderr[-500:]}
    return {"status": run.returncode, **found}


if __name__ == "__main__":
    main()
