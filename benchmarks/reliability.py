"""Numbers of the fault campaign: faults, kills, power cuts, simulated sessions, and Stop under a flood.

Everything runs on simulated cells. The results are ratios and counts, not absolute claims: every time is printed with a
bare timer's lateness in the same run, which the machine's scheduler adds. The whole benchmark takes hours; the options
scale each part down, and 0 skips it.

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

from pcmrs.testing.cell import open_cell
from pcmrs_lab.campaign.faults.adversary import FLOOD, stop_times
from pcmrs_lab.campaign.flood import flood
from pcmrs_lab.campaign.lateness import percentile, timer_lateness

SEED = 1


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=3, help="number of injections of every fault of the catalogue")
    parser.add_argument("--kills", type=int, default=10_000, help="kills of a process that writes the journal")
    parser.add_argument("--daemons", type=int, default=200, help="kills of the daemon in operation")
    parser.add_argument("--power", type=int, default=1_000, help="power cuts")
    parser.add_argument("--sessions-minutes", type=float, default=60.0, help="minutes of simulated sessions")
    parser.add_argument("--stops", type=int, default=1_000, help="Stops under a flood, and as many without")
    parser.add_argument("--datagrams", type=int, default=1_000_000, help="fuzzed datagrams")
    parser.add_argument("--workers", type=int, default=2, help="processes of sessions and catalogue")
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    found: dict[str, Any] = {"machine": platform.platform(), "python": platform.python_version(), "simulated": True}
    for name, measure in _parts(options).items():
        found[name] = measure()
        if not options.json:
            print(f"{name}: {json.dumps(found[name])}", flush=True)
    if options.json:
        print(json.dumps(found))


def _parts(options: argparse.Namespace) -> dict[str, Callable[[], dict[str, Any]]]:
    """Return the measurements in order."""
    kills = ("kill", "--times", options.kills, "--daemons", options.daemons)
    power = ("cut", "--cuts", 0, "--flips", 0, "--power", options.power)
    sessions = ("explore", "--sessions", 1_000_000, "--minutes", options.sessions_minutes, "--workers", options.workers)
    parts: dict[str, tuple[float, Callable[[], dict[str, Any]]]] = {
        "kills": (options.kills + options.daemons, lambda: _faults(*kills)),
        "power cuts": (options.power, lambda: _faults(*power)),
        "Stop": (options.stops, lambda: asyncio.run(_stops(options.stops))),
        "fuzzed datagrams": (options.datagrams, lambda: _faults("fuzz", "--datagrams", options.datagrams)),
        "simulated sessions": (options.sessions_minutes, lambda: _faults(*sessions)),
        "catalogue": (options.seeds, lambda: _catalogue(options.seeds, options.workers)),
    }
    return {name: measure for name, (amount, measure) in parts.items() if amount}


def _faults(*words: object, seeds: int = SEED) -> dict[str, Any]:
    """Return the report of a command of ``pcmrs faults``, and its exit status."""
    options = [word for seed in range(SEED, seeds + 1) for word in ("--seed", str(seed))]
    command = [sys.executable, "-m", "pcmrs.cli", "faults", *map(str, words), *options, "--json"]
    run = subprocess.run(command, capture_output=True, text=True, check=False)
    try:
        return {"status": run.returncode, **json.loads(run.stdout)}
    except ValueError:
        return {"status": run.returncode, "error": run.stderr[-500:]}


def _catalogue(seeds: int, workers: int) -> dict[str, Any]:
    """Return the results of all faults."""
    report = _faults("run", "--workers", workers, seeds=seeds)
    results = report.get("faults", [])
    rest = {f"{each['id']} seed {each['seed']}": each["response"] for each in results if each["outcome"] != "passed"}
    counts = Counter[str](each["outcome"] for each in results)
    return {"status": report["status"], "faults": len(results), **counts, "not passed": rest}


async def _stops(stops: int) -> dict[str, Any]:
    """Return the times until the daemon has begun to stop, with those of a bare timer, at rest and under a flood."""
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


if __name__ == "__main__":
    main()
