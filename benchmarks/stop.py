"""Stop at random moments of a motion: the time of each part, and that nothing moves once it is confirmed.

A separate daemon, on the simulated cell at real time, approaches, confirms, nudges, presses and follows a head that
breathes. Stop is pressed by a random route at a random moment: before the motion begins, in it, or after its end.
Routes are UDP, TCP, the bus (zenoh), the console's page, a peer that signs, and a remote operator with a certificate,
over TLS and a router. All processes share one monotonic clock, so the times of a Stop are stamped in them:

- `stop received to hold sent`: from the message of Stop in the daemon, or from the call that sends a datagram or opens
  a connection, until the daemon has sent its hold; the latch is set by then. Limit 20 ms (p99).
- `hold received to braking`: from the hold, or the message of Stop, in the node to the arm's first set point that
  brakes. Limit 20 ms. `hold received to arm told` is a part of it.
- `braking to standstill`: to the first joint state that stands. Its limit is the braking distance.
- `sign of life to hold`: another daemon is stopped by SIGSTOP in the middle of approaches (`deadman.py`); from its
  loop's last sign of life to the hold that its node begins by itself. Limit: deadman (100 ms) plus 25 ms.

The same run measures the lateness of a bare timer of 10 ms in this process. A limit is exceeded if a time is larger
than the limit plus the timer's lateness (p99 or max, like the limit). If the timer itself is later than the limit, the
machine was too busy to judge that limit, and the run does not pass.

`moved after confirmed` is the largest displacement of a joint from the first joint state after the confirmation until
half a second later; `beyond the braking distance` is the part of a joint's motion that its speed and its brakes do not
explain.

- `asked to begun, flood of ...`: daemons that are flooded (`stop_floods.py`); from a press by UDP or the bus to the
  event that reports it, received here. Limit 50 ms (p99), and 100 ms at most.

In simulated time (`stop_simulated.py`) the same motions are stopped `--stops` times, on several processors, over the
bus and as a string command. The other routes differ from these two only in what simulated time replaces: sockets,
frames, signatures and certificates. Behind those, TCP and a signing peer lead to the same intake of string commands,
the console and a remote operator to the same Stop of the bus.

    .venv/bin/python benchmarks/stop.py [real] [silence] [floods] [simulated] [--minutes 20] [--stops 10000]
        [--silences 50] [--pressed 100] [--flood KIND ...] [--seed 1] [--jobs 2] [--untimed] [--json]

Exit status 1: a joint moved after a confirmed Stop or went beyond its braking distance, a Stop was not confirmed, the
explorer's witness saw a violated invariant, or, unless `--untimed`, a time was above its limit. Exit status 2: nothing
is wrong, but a limit was not judged.
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

from pcmrs_lab.campaign.lateness import timer_lateness

PARTS = ("real", "silence", "floods", "simulated")


async def measure(options: argparse.Namespace) -> tuple[Found, list[float]]:
    """Return the results on real daemons, and the lateness of a bare timer meanwhile, s."""
    found = Found()
    async with timer_lateness() as timer:
        if "real" in options.parts:
            found.add(await stop_real.stopped(options.minutes, options.stops, options.seed))
        if "silence" in options.parts and options.silences:
            found.add(await stop_real.silenced(options.silences))
        if "floods" in options.parts and options.pressed:
            found.add(await stop_floods.flooded(options.pressed, options.flood or stop_floods.FLOODS))
    return found, timer.late


def simulate(options: argparse.Namespace) -> Found:
    """Return the results in simulated time."""

    def show(found: Found) -> None:
        print(f"{found.pressed.total()} of {options.stops} simulated Stops", file=sys.stderr)

    return stop_simulated.run_all(options.stops, options.seed, options.jobs, show)


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument(
        "parts", nargs="*", metavar="part", default=PARTS, help=f"one of {', '.join(PARTS)}; all by default"
    )
    parser.add_argument("--minutes", type=float, default=20.0, help="duration on the real daemon")
    parser.add_argument("--stops", type=int, default=10_000)
    parser.add_argument("--silences", type=int, default=50)
    parser.add_argument("--pressed", type=int, default=100, help="Stops by each route during each flood")
    parser.add_argument("--flood", action="append", choices=stop_floods.FLOODS, help="only this flood; may be repeated")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--jobs", type=int, default=2, help="number of processes of the simulated part")
    parser.add_argument("--untimed", action="store_true", help="show the times without checking their limits")
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    if unknown := set(options.parts) - set(PARTS):
        parser.error(f"Unknown part {', '.join(sorted(unknown))}; choose from {', '.join(PARTS)}.")
    found, late = uvloop.run(measure(options))
    report: dict[str, Any] = {"real": found.report()}
    report["real"]["ms"]["bare timer, late"] = stats(late, 1e3)
    wrong = found.wrong + ([] if options.untimed else found.late(late))
    not_judged = [] if options.untimed else found.not_judged(late)
    if "simulated" in options.parts:
        started = time.monotonic()
        simulated = simulate(options)
        report["simulated"] = simulated.report() | {"seconds": round(time.monotonic() - started, 1)}
        wrong += simulated.wrong + ([] if options.untimed else simulated.late([]))
    if options.json:
        print(json.dumps(report | {"wrong": wrong, "not judged": not_judged}, indent=2))
    else:
        show(report, wrong, not_judged)
    sys.exit(1 if wrong else 2 if not_judged else 0)


def show(report: dict[str, Any], wrong: list[str], not_judged: list[str]) -> None:
    """Print the report for people.

    Args:
        report: Results by part.
        wrong: Descriptions of what is wrong.
        not_judged: Descriptions of the limits that the machine was too busy for.
    """
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
    for each in not_judged:
        print(f"NOT JUDGED: {each}")


if __name__ == "__main__":
    main()
