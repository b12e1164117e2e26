"""Time from the daemon's silence to the node's hold: how precisely the deadman of a device node expires.

In every run the simulated arm approaches at real time, and the daemon, a separate process, is stopped by SIGSTOP in the
middle of it; the node logs when it holds the arm. `silence` is measured by the node itself, from the last heartbeat;
`stopped` is measured from the signal, which falls anywhere between two heartbeats. The first braking set point follows
within one step of the arm's stream (10 ms for the simulated cell). The same run measures the lateness of a bare asyncio
timer and of a bare thread's wait of the same length in idle processes: the delay of this machine's scheduler is part of
all times. `hogs` repeats it with one busy process per processor.

    .venv/bin/python benchmarks/deadman.py [idle hogs quiet] [--runs 50] [--deadman 0.1] [--json]

`quiet` stops nothing: it counts how often the deadman fires in undisturbed approaches, and shows the longest time
between two heartbeats of the daemon as another process receives them.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import multiprocessing
import os
import platform
import re
import signal
import tempfile
import threading
import time
from collections.abc import AsyncIterator, Iterator
from contextlib import AsyncExitStack, asynccontextmanager, contextmanager, nullcontext, suppress
from datetime import datetime
from pathlib import Path

import msgspec
import numpy as np
import uvloop

from pcmrs.bus import Bus, BusSettings
from pcmrs.client import Client
from pcmrs.devices.node import DAEMON_BEAT
from pcmrs.messages import Beat, JointState
from pcmrs.testing.daemon import own_settings, running_daemon
from pcmrs.testing.plan import example_plan, read_plan

HELD = re.compile(r"(\S+Z) .*held_by_node.*silence=(\S+)")
PATIENCE = 20.0
TRIES = 5
SLOW = (
    "procedure.max_pose_age=3",  # not measured here
    "procedure.motion.linear_velocity=0.03",
    "procedure.motion.joint_speed_fraction=0.2",
    "procedure.placement.tolerance_mm=0.5",
    "procedure.placement.tolerance_deg=0.2",
    "procedure.registration.samples=5",
    "sim.digitization.reach_time=0.1",
    "sim.digitization.rest_time=0.1",
)
Report = dict[str, dict[str, float]]


class NotAcceptedError(Exception):
    """The daemon did not accept a command that moves the arm to its start."""


class Bench:
    """Daemon whose arm can be moved."""

    def __init__(self, pid: int, log: Path, client: Client, bus: Bus) -> None:
        self.pid, self.client = pid, client
        self._log = log
        self._moving = asyncio.Event()
        self.beats: list[float] = []
        bus.subscribe("state/joints", JointState, self._look)
        bus.subscribe(DAEMON_BEAT, Beat, lambda _key, _beat: self.beats.append(time.monotonic()))

    def _look(self, _key: str, state: JointState) -> None:
        (self._moving.set if np.abs(state.velocities).max() > 5e-3 else self._moving.clear)()

    def holds(self) -> list[tuple[float, float]]:
        """Return Unix time and silence, s, of every hold that a node has logged."""
        found = HELD.findall(self._log.read_text())
        return [(datetime.fromisoformat(stamp).timestamp(), float(silence)) for stamp, silence in found]

    async def call(self, name: str, **arguments: object) -> None:
        """Request an operation, which must be accepted.

        Args:
            name: Operation, ``branch.operation``.
            arguments: Arguments of the operation.

        Raises:
            NotAcceptedError: It was not accepted.
        """
        verdict = await self.client.call(name, arguments, timeout=PATIENCE)
        if verdict.decision != "accepted":
            raise NotAcceptedError(f"{name}: {verdict.decision} {verdict.reason}")

    async def prepare(self) -> None:
        """Register the head and plan a pose."""
        plan = read_plan(example_plan("ratms"))
        await self.call("robot.connect")
        await self.call("registration.plan_landmarks", landmarks=[msgspec.to_builtins(each) for each in plan.landmarks])
        await self.call("digitization.digitize_all")
        await self.call("registration.register")
        await self.call("toolplan.plan", **msgspec.to_builtins(plan.poses[0]))
        if (await self.client.state()).branches["placement"] == "unknown":
            await self.call("placement.locate")

    async def recover(self) -> None:
        """Move the arm back to where an approach may begin; on a busy machine this may need retries."""
        for _ in range(TRIES):
            with suppress(NotAcceptedError):
                return await self._go_home()
        raise NotAcceptedError("the arm did not reach its home pose")

    async def _go_home(self) -> None:
        async with asyncio.timeout(PATIENCE):
            while (await self.client.state()).running:  # noqa: ASYNC110
                await asyncio.sleep(0.05)
        await asyncio.sleep(0.3)  # reports of the node are still in transit
        if (await self.client.state()).branches["robot"] == "0":
            await self.call("robot.connect")
        if (snapshot := await self.client.state()).latched:
            await self.client.acknowledge(stop=snapshot.stop.number)
        if (await self.client.state()).branches["placement"] == "unknown":
            await self.call("placement.locate")
        if (await self.client.state()).branches["placement"] == "held":
            await self.call("placement.back_off")
        if (await self.client.state()).branches["placement"] == "standoff":
            await self.call("placement.home")

    async def stopped(self) -> tuple[float, float] | None:
        """Return the time from the signal to the hold, and the node's silence, s; None if the motion ended before."""
        before = len(self.holds())
        approach = asyncio.create_task(self.client.call("placement.approach", timeout=PATIENCE))
        moving = asyncio.create_task(self._moving.wait())
        await asyncio.wait([approach, moving], return_when=asyncio.FIRST_COMPLETED)
        await asyncio.sleep(0.2 + 0.1 * np.random.default_rng().random())
        moving.cancel()
        found = None if approach.done() or len(self.holds()) > before else await self._silenced(before)
        verdict = await approach
        if found is not None and verdict.decision == "accepted":
            raise RuntimeError("the approach continued")
        await self.recover()
        return found

    async def _silenced(self, before: int) -> tuple[float, float]:
        signalled = time.time()
        os.kill(self.pid, signal.SIGSTOP)
        try:
            async with asyncio.timeout(PATIENCE):
                while len(self.holds()) == before:  # noqa: ASYNC110
                    await asyncio.sleep(0.05)
        finally:
            os.kill(self.pid, signal.SIGCONT)
        held, silence = self.holds()[before]
        return held - signalled, silence


@asynccontextmanager
async def bench(deadman: float) -> AsyncIterator[Bench]:
    """Start a daemon whose nodes have a deadman, s."""
    with tempfile.TemporaryDirectory(prefix="pcmrs-") as folder:
        cell = f"deadman-{os.getpid()}"
        settings = [*own_settings(Path(folder), cell), *SLOW, f"robot.deadman={deadman}"]
        log = Path(folder) / "log"
        async with running_daemon(settings, log) as daemon, AsyncExitStack() as stack:
            bus = await Bus.open(BusSettings(endpoint=daemon.ready.endpoint, cell=cell))
            stack.push_async_callback(bus.close)
            client = await stack.enter_async_context(Client.connect(daemon.ready.endpoint, cell=cell))
            made = Bench(daemon.process.pid, log, client, bus)
            await made.prepare()
            yield made


@contextmanager
def hogs() -> Iterator[None]:
    """Run one busy process per processor for the length of the context."""
    processes = [multiprocessing.Process(target=_hog, daemon=True) for _ in range(os.cpu_count() or 1)]
    for process in processes:
        process.start()
    try:
        yield
    finally:
        for process in processes:
            process.kill()
            process.join()


def _hog() -> None:
    while True:
        sum(range(100_000))


class Timers:
    """Processes that measure the lateness of an asyncio timer and of a thread's wait, each of the deadman's length."""

    def __init__(self, length: float) -> None:
        self._end = multiprocessing.Event()
        self._length = length
        self._late: dict[str, multiprocessing.Queue[list[float]]] = {
            name: multiprocessing.Queue() for name in ("asyncio", "thread")
        }
        self._processes = [
            multiprocessing.Process(target=_measure, args=(name, length, self._end, queue), daemon=True)
            for name, queue in self._late.items()
        ]

    def __enter__(self) -> Timers:
        for process in self._processes:
            process.start()
        return self

    def __exit__(self, *_error: object) -> None:
        self._end.set()

    def report(self) -> Report:
        """Return the statistics of the lateness, ms."""
        found = {f"bare {name} timer, late": stats(queue.get(timeout=10.0)) for name, queue in self._late.items()}
        for process in self._processes:
            process.join()
        return found


def _measure(name: str, length: float, end: threading.Event, queue: multiprocessing.Queue[list[float]]) -> None:
    late: list[float] = []
    if name == "asyncio":
        uvloop.run(_asyncio_timer(length, end, late))
    else:
        waiting = threading.Event()
        while not end.is_set():
            started = time.monotonic()
            waiting.wait(length)
            late.append(time.monotonic() - started - length)
    queue.put(late)


async def _asyncio_timer(length: float, end: threading.Event, late: list[float]) -> None:
    while not end.is_set():
        started = time.monotonic()
        await asyncio.sleep(length)
        late.append(time.monotonic() - started - length)


def stats(seconds: list[float]) -> dict[str, float]:
    """Return number, quantiles and maximum of times, ms."""
    found = np.array(seconds) * 1e3
    quantiles = {f"p{q:g}": round(float(np.percentile(found, q)), 2) for q in (50, 99)}
    return {"n": len(found), **quantiles, "max": round(float(found.max()), 2)}


async def silences(made: Bench, runs: int) -> tuple[list[tuple[float, float]], int]:
    """Return the results of `Bench.stopped`, and the number of approaches that were needed.

    Args:
        made: Running bench.
        runs: Number of results.
    """
    tried = 0
    found: list[tuple[float, float]] = []
    while len(found) < runs and tried < 3 * runs:
        tried += 1
        if (run := await made.stopped()) is not None:
            found.append(run)
    return found, tried


async def stops(runs: int, deadman: float, *, hogged: bool) -> Report:
    """Return the statistics of runs in which the daemon is stopped, ms.

    Args:
        runs: Number of runs.
        deadman: Deadman of the nodes, s.
        hogged: True to run busy processes at the same time.
    """
    async with bench(deadman) as made:
        with Timers(deadman) as timers, hogs() if hogged else nullcontext():
            found, tried = await silences(made, runs)
        report = {"approaches": {"n": float(tried), "ended before": float(tried - len(found))}}
        report["stopped to hold"] = stats([stopped for stopped, _ in found])
        report["silence at hold"] = stats([silence for _, silence in found])
        late = [silence - deadman for _, silence in found]
        report["hold, late"] = stats(late)
        report["within 120 ms of silence"] = {
            "n": float(sum(silence <= deadman + 0.02 for _, silence in found)),
            "of": float(len(found)),
        }
        return report | timers.report()


async def quiet(runs: int, deadman: float) -> Report:
    """Return the numbers of holds and the times between heartbeats in undisturbed approaches.

    Args:
        runs: Number of approaches.
        deadman: Deadman of the nodes, s.
    """
    async with bench(deadman) as made:
        made.beats.clear()
        refused = 0
        for _ in range(runs):
            verdict = await made.client.call("placement.approach", timeout=2 * PATIENCE)
            if verdict.decision == "accepted":
                await made.call("placement.home")
            else:
                refused += 1
                await made.recover()
        return {
            "approaches": {"n": float(runs), "not accepted": float(refused), "holds": float(len(made.holds()))},
            "between heartbeats": stats(np.diff(made.beats).tolist()),
        }


async def measure(what: list[str], runs: int, deadman: float) -> dict[str, Report]:
    """Return the results of some measurements.

    Args:
        what: Names of measurements.
        runs: Number of runs of each.
        deadman: Deadman of the nodes, s.
    """
    found: dict[str, Report] = {}
    for each in what:
        found[each] = await (quiet(runs, deadman) if each == "quiet" else stops(runs, deadman, hogged=each == "hogs"))
    return found


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", nargs="*", default=["idle", "hogs", "quiet"])
    parser.add_argument("--runs", type=int, default=50)
    parser.add_argument("--deadman", type=float, default=0.1)
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    found = uvloop.run(measure(options.what, options.runs, options.deadman))
    if options.json:
        print(json.dumps(found, indent=2))
        return
    print(f"Simulated cell, {platform.processor() or platform.machine()}, {os.cpu_count()} processors; ms.")
    for name, report in found.items():
        print(f"\n{name}")
        for row, values in report.items():
            print(f"  {row:<28}" + "  ".join(f"{key} {value:g}" for key, value in values.items()))


if __name__ == "__main__":
    main()
