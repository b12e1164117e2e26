"""Stop on a real daemon, its nodes and the simulated arm at real time, pressed by every route at random moments."""

from __future__ import annotations

import asyncio
import random
import tempfile
import time
from collections.abc import Awaitable, Callable, Mapping
from pathlib import Path
from typing import Any

import deadman
import numpy as np
from stop_found import BRAKING, BREATHING, LATCHED, SILENCE, STANDSTILL, Braking, Found, farthest
from stop_routes import BY_SOCKET, ROUTES, Press, stoppable_cell
from stop_stamps import Stamps, stamping

from pcmrs.client import Client
from pcmrs.messages import HeadMotion, JointState, Snapshot, Verdict
from pcmrs.testing.cell import RunningCell
from pcmrs.testing.driving import register, to_placed, to_retracted, to_standoff, until, wait_until_stationary
from pcmrs.testing.errors import Unmet

MOTIONS: dict[str, tuple[Callable[[Client], Awaitable[None]], dict[str, Any]]] = {
    "approach": (to_retracted, {}),
    "confirm": (to_standoff, {}),
    "nudge": (to_placed, {"translation": [0.0, 0.0, 0.004]}),
    "press": (to_placed, {"force": 3.0}),
    "follow": (to_placed, {}),
}
LATEST = 1.5
"""Largest time from the request of the motion to the press of Stop, s."""
MOVED = 2e-3
"""Displacement at which a joint counts as moved, rad: the arm has dynamics and a controller, and sways by less."""
LOOK = 0.5
"""Time for which the arm is observed after a confirmed Stop, s."""
TRIES = 10
"""Number of motions in a row that may fail to start, as on a machine that is too busy for a cell in real time."""
DEADMAN = 0.1
"""Deadman of the cell whose daemon is stopped, s."""


class _Bench:
    """Presser of Stop that observes the arm."""

    def __init__(self, cell: RunningCell, presses: Mapping[str, Press], stamps: Stamps, draw: random.Random) -> None:
        self.found = Found()
        self._cell, self._presses, self._stamps, self._draw = cell, presses, stamps, draw
        self._joints: list[JointState] = []
        cell.client.listen("state/joints", JointState, self._joints.append)

    async def run(self, stops: int, ends: float) -> None:
        """Stop a number of times, or until a time of the machine; give up when `TRIES` motions in a row did not start.

        Args:
            stops: Number of Stops.
            ends: Time of the machine, s.
        """
        failed = 0
        while self.found.pressed.total() < stops and time.monotonic() < ends:
            try:
                await self._stop_one(self._draw.choice(list(MOTIONS)), self._draw.choice(ROUTES))
                failed = 0
            except Unmet as unmet:
                failed += 1
                self.found.notes[f"no motion: {unmet.text}"] += 1
                if failed == TRIES:
                    self.found.wrong.append(f"Given up after {TRIES} motions that did not start: {unmet.text}")
                    return

    async def _stop_one(self, name: str, route: str) -> None:
        bring, arguments = MOTIONS[name]
        client, scene = self._cell.client, self._cell.scene
        await self._recover()
        await bring(client)
        number = (await client.state()).stop.number
        if name == "follow":
            await scene.set_motion(BREATHING)
        motion = asyncio.create_task(client.call(f"placement.{name}", arguments, timeout=60.0))
        await asyncio.sleep(self._draw.uniform(0.0, LATEST))
        self._joints.clear()
        confirmed = asyncio.create_task(until(client, lambda shown: _is_confirmed(shown, number)))
        await asyncio.sleep(0)  # the task subscribes before Stop is pressed
        pressed_at = time.monotonic()
        pressing = asyncio.ensure_future(self._presses[route]())
        self.found.pressed[f"{name} by {route}"] += 1
        try:
            await confirmed
            done = time.monotonic()
        except Unmet:
            self.found.wrong.append(f"{name} by {route}: the Stop was not confirmed.")
            return
        finally:
            await asyncio.wait([pressing])
            await scene.set_motion(HeadMotion())
        pressing.result()
        verdict: Verdict = await motion
        await asyncio.sleep(LOOK)
        if verdict.decision == "rejected":
            self.found.notes[f"{name} rejected"] += 1
        self._measure(f"{name} by {route}", route, pressed_at, done)

    def _measure(self, what: str, route: str, pressed_at: float, done: float) -> None:
        stamps, times, daemon = self._stamps.since(pressed_at), self.found.times, self._cell.process.pid

        def first(*names: str, of_daemon: bool, after: float = pressed_at) -> float | None:
            found = (s for s in stamps if s["what"] in names and (s["process"] == daemon) is of_daemon)
            return next((float(each["at"]) for each in found if each["at"] >= after), None)

        received = pressed_at if route in BY_SOCKET else first("stop received", of_daemon=True)
        sent = first("hold sent", of_daemon=True)
        taken = first("stop received", "hold received", of_daemon=False)
        times["asked to confirmed"].append(done - pressed_at)
        if received is None or sent is None or taken is None:
            self.found.wrong.append(f"{what}: no hold of the robot was sent and received.")
            return
        times[LATCHED].append(sent - received)
        self._look_at_the_arm(what, stamps, taken, done)

    def _look_at_the_arm(self, what: str, stamps: list[dict[str, Any]], taken: float, done: float) -> None:
        found, times = self.found, self.found.times
        after = [np.array(each.positions) for each in self._joints if each.captured > done]
        if not after:
            found.wrong.append(f"{what}: the arm was not observed after the confirmation.")
            return
        found.moved.append(farthest(after[0], after))
        if found.moved[-1] > MOVED:
            found.wrong.append(f"{what}: a joint moved by {found.moved[-1]:.4f} rad after the confirmed Stop.")
        hold_called_at = next(
            (each["at"] for each in stamps if each["what"] == "arm told" and each["at"] >= taken), None
        )
        stamp = next((each for each in stamps if each["what"] == "braking" and each["at"] >= taken), None)
        if hold_called_at is None or stamp is None:
            return  # the arm stood
        found.moving[what] += 1
        times["hold received to arm told"].append(hold_called_at - taken)
        times[BRAKING].append(stamp["at"] - taken)
        braking = Braking.at(stamp["at"], stamp["positions"], stamp["velocities"])
        later = [each for each in self._joints if each.captured >= braking.started_at]
        found.beyond.append(max((braking.beyond(np.array(each.positions)) for each in later), default=0.0))
        if found.beyond[-1] > MOVED:
            text = f"{what}: a joint went {found.beyond[-1]:.4f} rad beyond its braking distance."
            found.wrong.append(text)
        standing = next((each.captured for each in later if not each.moving), None)
        if standing is not None:
            times[STANDSTILL].append(standing - braking.started_at)

    async def _recover(self) -> None:
        client = self._cell.client
        await until(client, lambda shown: not shown.running and not shown.stop.pending)
        await wait_until_stationary(client)


def _is_confirmed(shown: Snapshot, before: int) -> bool:
    return shown.latched and shown.stop.number > before and shown.stop.confirmed


async def stopped(minutes: float, stops: int, seed: int) -> Found:
    """Stop a running cell at random moments.

    Args:
        minutes: Largest duration, min.
        stops: Largest number of Stops.
        seed: Seed of motions, routes and moments.

    Returns:
        Results.
    """
    with tempfile.TemporaryDirectory(prefix="pcmrs-", ignore_cleanup_errors=True) as parent:
        folder, stamps = Path(parent) / "stop", Path(parent) / "stamps"
        for each in (folder, stamps):
            each.mkdir()
        async with stoppable_cell(folder, stamping(stamps)) as (cell, presses):
            await register(cell.client)
            bench = _Bench(cell, presses, Stamps(stamps), random.Random(seed))
            await bench.run(stops, time.monotonic() + 60.0 * minutes)
            return bench.found


async def silenced(runs: int) -> Found:
    """Stop the daemon itself by SIGSTOP, until the node holds by itself."""
    found = Found()
    async with deadman.bench(DEADMAN) as made:
        runs_found, tried = await deadman.silences(made, runs)
    found.times[SILENCE] += [silence for _, silence in runs_found]
    found.notes["approaches of the cell that is silenced"] += tried
    return found
