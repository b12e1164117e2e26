"""Stop at random moments of a motion: how long each part of it takes, and that nothing moves once it is confirmed.

A daemon of its own, on the simulated cell at real time, approaches, confirms, nudges, presses and follows a head that
breathes. Stop is pressed by a route and at a moment that are drawn: before the motion begins, in it, or when it has
ended. Routes are UDP, TCP, the bus (zenoh), the console's page, a peer that signs, and somebody far away with a
certificate, over TLS and a router. All processes have one monotonic clock, so the times of a Stop are stamped in them:

- `stop received to hold sent`: from the message of Stop in the daemon, or from the call that sends a datagram or opens
  a connection, to the daemon's hold on its way; the latch is set by then. Limit 20 ms (p99).
- `hold received to braking`: from the hold, or the message of Stop, in the node to the arm's first set point that
  brakes. Limit 20 ms. `hold received to arm told` is a part of it.
- `braking to standstill`: to the first joint state that stands. Its limit is the braking distance.
- `sign of life to hold`: another daemon is stopped by SIGSTOP in the middle of approaches (`deadman.py`); from its
  loop's last sign of life to the hold that its node begins by itself. Limit: deadman (100 ms) and 25 ms.

Beside them, in the same run: how late a bare timer of 10 ms is in this process. A limit is exceeded where a time is
above the limit and the timer's lateness (p99 or max, as the limit has it).

`moved after confirmed` is the largest displacement of a joint from the first joint state after the confirmation until
half a second later; `beyond the braking distance` how far a joint went further than its speed and its brakes explain.

- `asked to begun, flood of ...`: daemons whose bus somebody floods (`stop_floods.py`); from a press by UDP or the bus
  to the event that tells of it, received here. Limit 50 ms (p99), and 100 ms at most.

In simulated time (`stop_simulated.py`) the same motions are stopped as often as asked for, on both processors.

    .venv/bin/python benchmarks/stop.py [real] [silence] [floods] [simulated] [--minutes 20] [--stops 10000]
        [--silences 50] [--pressed 100] [--flood KIND ...] [--seed 1] [--jobs 2] [--untimed] [--json]

Exit status 1: a joint moved after a confirmed Stop or went beyond its braking distance, a Stop was not confirmed, the
explorer's witness saw an invariant broken, or, unless `--untimed`, a time was above its limit.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import sys
import time
from typing import Any

import stop_floods
import stop_real
import stop_simulated
import uvloop
from stop_found import Found, stats

from pcmrs_lab.campaign.bus_flood import KINDS
from pcmrs_lab.campaign.lateness import timer_lateness

PARTS = ("real", "silence", "floods", "simulated")


async def measure(options: argparse.Namespace) -> tuple[Found, list[float]]:
    """What was found on real daemons, and how late a bare timer was meanwhile, s."""
    found = Found()
    async with timer_lateness() as timer:
        if "real" in options.parts:
            found.add(await stop_real.stopped(options.minutes, options.stops, options.seed))
        if "silence" in options.parts and options.silences:
            found.add(await stop_real.silenced(options.silences))
        if "floods" in options.parts and options.pressed:
            found.add(await stop_floods.flooded(options.pressed, options.flood or KINDS))
    return found, timer.late


def simulate(options: argparse.Namespace) -> Found:
    """The same in simulated time."""

    def show(found: Found) -> None:
        print(f"{found.pressed.total()} of {options.stops} simulated Stops", file=sys.stderr)

    return stop_simulated.run_all(options.stops, options.seed, options.jobs, show)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("parts", nargs="*", metavar="part", default=PARTS, help=f"of {', '.join(PARTS)}; all of them")
    parser.add_argument("--minutes", type=float, default=20.0, help="of the real daemon")
    parser.add_argument("--stops", type=int, default=10_000)
    parser.add_argument("--silences", type=int, default=50)
    parser.add_argument("--pressed", type=int, default=100, help="Stops by each route during each flood")
    parser.add_argument("--flood", action="append", choices=KINDS, help="of the floods, only this; may be repeated")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--jobs", type=int, default=2, help="processes of the simulated part")
    parser.add_argument("--untimed", action="store_true", help="show the times, and hold them against no limit")
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    if unknown := set(options.parts) - set(PARTS):
        parser.error(f"There is no part {', '.join(sorted(unknown))}; there are {', '.join(PARTS)}.")
    found, late = uvloop.run(measure(options))
    report: dict[str, Any] = {"real": found.report()}
    report["real"]["ms"]["bare timer, late"] = stats(late, 1e3)
    wrong = found.wrong + ([] if options.untimed else found.late(late))
    if "simulated" in options.parts:
        begun = time.monotonic()
        simulated = simulate(options)
        report["simulated"] = simulated.report() | {"seconds": round(time.monotonic() - begun, 1)}
        wrong += simulated.wrong + ([] if options.untimed else simulated.late([]))
    if options.json:
        print(json.dumps(report | {"wrong": wrong}, indent=2))
    else:
        show(report, wrong)
    sys.exit(bool(wrong))


def show(report: dict[str, Any], wrong: list[str]) -> None:
    """Prints the report for people."""
    print(f"Simulated cell, {platform.processor() or platform.machine()}, {os.cpu_count()} processors.")
    for part, values in report.items():
        print(f"{part}:")
        for name, row in values.pop("ms").items():
            print(f"  {name + ', ms':<40}" + "  ".join(f"{key} {value:.4g}" for key, value in row.items()))
        for name, row in values.items():
            text = "  ".join(f"{key} {value}" for key, value in row.items()) if isinstance(row, dict) else row
            print(f"  {name:<40}{text}")
    for each in wrong:
        print(f"WRONG: {each}")


if __name__ == "__main__":
    main()
