"""Stop at random moments of a motion: how long each part of it takes, and that nothing moves once it is confirmed.

A daemon of its own, on the simulated cell at real time, approaches, confirms, nudges, presses and follows the head.
Stop is pressed by a route and at a moment that are drawn: before the motion begins, in it, or when it has ended. All
processes have one monotonic clock, so these times are measured across them:

- `asked to hold sent`: from the call of the one who stops to the daemon's hold on its way; the latch is set by then.
- `hold sent to received`: to the node of the arm.
- `received to braking` and `braking to standstill`: by the arm's own joint states, 100 a second; only where it moved.
- `asked to confirmed`: until a snapshot says that standstill was measured after the newest hold.

`moved after confirmed` is the largest displacement of a joint from the first joint state after the confirmation until
half a second later, in degrees. Beside them, in the same run: how late a bare timer of 10 ms is in this process.

    .venv/bin/python benchmarks/stop.py [--minutes 20] [--stops 10000] [--seed 1] [--json]

Exit status 1: a joint has moved by more than 0.12 degrees after a confirmed Stop, or a Stop was not confirmed.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import os
import platform
import random
import sys
import tempfile
import time
from collections import defaultdict
from collections.abc import Awaitable, Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import uvloop

from pcmrs.campaign.delays import Rule
from pcmrs.campaign.driving import accept, register, state, to_placed, to_retracted, to_standoff, until
from pcmrs.campaign.fault import Unmet
from pcmrs.campaign.lab import REAL_TIME, LabCell, open_cell
from pcmrs.campaign.lateness import percentile, timer_lateness
from pcmrs.client import Client
from pcmrs.messages import JointState, Snapshot

MOTIONS: dict[str, tuple[Callable[[Client], Awaitable[None]], dict[str, Any]]] = {
    "approach": (to_retracted, {}),
    "confirm": (to_standoff, {}),
    "nudge": (to_placed, {"translation": [0.0, 0.0, 0.004]}),
    "press": (to_placed, {"force": 3.0}),
    "follow": (to_placed, {}),
}
ROUTES = ("udp", "tcp", "zenoh")
LATEST = 1.5
"""Stop is pressed within this after the motion was asked for, s."""
MOVES = 5e-3
"""A joint that is faster moves, rad/s."""
SLOWER = 0.98
"""An arm that is slower than this share of its speed at the hold brakes."""
MOVED = 2e-3
"""A joint that has gone further than this after the confirmation has moved, rad."""
LOOK = 0.5
OFTEN = 1_000_000

State = tuple[float, np.ndarray, float]


@dataclass
class Found:
    """What was measured, s and rad."""

    times: dict[str, list[float]] = field(default_factory=lambda: defaultdict(list))
    moved: list[float] = field(default_factory=list)
    pressed: dict[str, int] = field(default_factory=lambda: defaultdict(int))
    refused: dict[str, int] = field(default_factory=lambda: defaultdict(int))
    unconfirmed: int = 0


class Bench:
    """Presses Stop, and looks at the arm."""

    def __init__(self, cell: LabCell, generator: random.Random) -> None:
        self.found = Found()
        self._cell, self._random = cell, generator
        self._states: list[State] = []
        self._sent = Rule("send", "dev/robot/cmd", "hold", times=OFTEN)
        self._received = Rule("receive", "dev/robot/cmd", "hold", times=OFTEN)
        cell.client.listen("state/joints", JointState, self._look)

    def _look(self, joints: JointState) -> None:
        positions, speed = np.array(joints.positions), float(np.abs(joints.velocities).max())
        self._states.append((time.monotonic(), positions, speed))

    async def run(self, stops: int, ends: float) -> None:
        """Stops so often, or until a time of the machine."""
        async with self._cell.delays.delaying(self._sent, self._received):
            for _ in range(stops):
                if time.monotonic() > ends:
                    break
                await self._stop_one(self._random.choice(list(MOTIONS)), self._random.choice(ROUTES))

    async def _stop_one(self, name: str, route: str) -> None:
        bring, arguments = MOTIONS[name]
        client = self._cell.client
        await self._recover()
        await bring(client)
        number = (await client.state()).stop.number
        motion = asyncio.create_task(client.call(f"placement.{name}", arguments, timeout=60.0))
        await asyncio.sleep(self._random.uniform(0.0, LATEST))
        self._states.clear()
        await asyncio.sleep(0.05)  # a few states from before
        confirmed = asyncio.create_task(until(client, lambda shown: _is_confirmed(shown, number)))
        asked = time.monotonic()
        await self._press(route)
        try:
            await confirmed
        except Unmet:
            self.found.unconfirmed += 1
            return
        done = time.monotonic()
        verdict = await motion
        await asyncio.sleep(LOOK)
        self.found.pressed[f"{name} by {route}"] += 1
        if verdict.decision == "rejected":
            self.found.refused[name] += 1
        await self._measure(asked, done)

    async def _press(self, route: str) -> None:
        if route == "udp":
            await self._cell.planner.stop()
        elif route == "tcp":
            reader, writer = await asyncio.open_connection(*self._cell.ready.links["tcp"])
            writer.write(b"stop_now_xxxxxxx;")
            await writer.drain()
            await reader.read(64)
            writer.close()
        else:
            await self._cell.client.stop()

    async def _measure(self, asked: float, done: float) -> None:
        hold, taken = await self._first(self._sent, asked), await self._first(self._received, asked)
        times = self.found.times
        times["asked to hold sent"].append(hold - asked)
        times["hold sent to received"].append(taken - hold)
        times["asked to confirmed"].append(done - asked)
        self._look_back(taken, done)

    async def _first(self, rule: Rule, after: float) -> float:
        records = await self._cell.delays.took_place(rule)
        return next(record.begun for record in records if record.begun > after)

    def _look_back(self, taken: float, done: float) -> None:
        after = [positions for at, positions, _ in self._states if at > done]
        if after:
            self.found.moved.append(max(float(np.abs(each - after[0]).max()) for each in after))
        before = [speed for at, _, speed in self._states if at <= taken]
        if not before or before[-1] < MOVES:
            return
        later = [(at, speed) for at, _, speed in self._states if at > taken]
        braking = next((at for at, speed in later if speed < SLOWER * before[-1]), None)
        standing = next((at for at, speed in later if speed < MOVES), None)
        if braking is not None and standing is not None:
            self.found.times["received to braking"].append(braking - taken)
            self.found.times["braking to standstill"].append(standing - braking)

    async def _recover(self) -> None:
        client = self._cell.client
        shown = await until(client, lambda shown: not shown.running and not shown.stop.pending)
        if shown.latched:
            await accept(client, "robot.acknowledge", stop=shown.stop.number)
        if await state(client, "placement") in ("held", "following"):
            await accept(client, "placement.back_off")


def _is_confirmed(shown: Snapshot, before: int) -> bool:
    return shown.latched and shown.stop.number > before and not shown.stop.pending


async def measure(minutes: float, stops: int, seed: int) -> tuple[Found, list[float]]:
    """Runs the benchmark; returns what was found, and how late a bare timer was, s."""
    with tempfile.TemporaryDirectory(prefix="pcmrs-", ignore_cleanup_errors=True) as folder:
        async with open_cell(Path(folder) / "stop", REAL_TIME, delayed=True) as cell, timer_lateness() as timer:
            await register(cell.client)
            bench = Bench(cell, random.Random(seed))
            await bench.run(stops, time.monotonic() + 60.0 * minutes)
            return bench.found, timer.late


def stats(values: list[float], scale: float) -> dict[str, float]:
    quantiles = {name: round(percentile(values, share) * scale, 3) for name, share in (("p50", 0.5), ("p99", 0.99))}
    return {"n": len(values), **quantiles, "max": round(max(values, default=0.0) * scale, 3)}


def report(found: Found, late: list[float]) -> dict[str, Any]:
    return {
        "ms": {name: stats(values, 1e3) for name, values in found.times.items()}
        | {"bare timer, late": stats(late, 1e3)},
        "moved after confirmed, deg": stats([float(np.degrees(each)) for each in found.moved], 1.0),
        "pressed": dict(sorted(found.pressed.items())),
        "motions refused": dict(found.refused),
        "not confirmed": found.unconfirmed,
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--minutes", type=float, default=20.0)
    parser.add_argument("--stops", type=int, default=10_000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    found, late = uvloop.run(measure(options.minutes, options.stops, options.seed))
    values = report(found, late)
    if options.json:
        print(json.dumps(values, indent=2))
    else:
        print(f"Simulated cell, {platform.processor() or platform.machine()}, {os.cpu_count()} processors.")
        for name, row in (*values["ms"].items(), ("moved after confirmed, deg", values["moved after confirmed, deg"])):
            print(f"  {name:<28}" + "  ".join(f"{key} {value:g}" for key, value in row.items()))
        for name in ("pressed", "motions refused", "not confirmed"):
            print(f"  {name}: {values[name]}")
    if found.unconfirmed or max(found.moved, default=0.0) > MOVED:
        sys.exit(1)


if __name__ == "__main__":
    main()
