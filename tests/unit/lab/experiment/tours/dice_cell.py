"""A cell that is only a dispatcher and dice: checks refuse now and then, and steps end as the dice say."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncGenerator, Mapping
from random import Random
from typing import Any, cast

from pcmrs.client import Client, Event
from pcmrs.clock import SystemClock
from pcmrs.dispatcher import Dispatcher, DispatcherListener, ProcedureData, Run
from pcmrs.errors import RefusalError, UnknownOutcomeError
from pcmrs.fsm import Blueprint, Closure
from pcmrs.messages import Command, DeviceEvent, Snapshot, Verdict
from pcmrs.testing.rehearsal import NullRecorder, ScriptedSteps, scripted
from pcmrs_lab.experiment.tours.arguments import TourArguments
from pcmrs_lab.experiment.tours.report import TourReport
from pcmrs_lab.experiment.tours.run import tour_live
from tests.unit.lab.blueprints import ratms

TURNS = 40
"""Turns of the event loop that a step takes: enough for Stop to come in between."""

QUIET_TURNS = 5 * TURNS
"""Turns of the event loop without a command, after which the coil is seen aligned."""

NOTHING: Mapping[str, Any] = {}

PAYLOADS = ("landmarks", "landmark_index", "surface_points", "surface_name", "tool_pose", "nudge", "press")
EMPTY = {payload: cast(dict[str, Any], {}) for payload in PAYLOADS}


class Dice(ScriptedSteps):
    """Checks that refuse now and then, and steps that end as the dice say."""

    def __init__(self, seed: int, refusing: float) -> None:
        self.dispatcher: Dispatcher[None, ProcedureData] | None = None
        self._rng = Random(seed)
        self._refusing = refusing

    def check(self, name: str, _run: Run[None, ProcedureData]) -> None:
        if self._rng.random() < self._refusing:
            raise RefusalError("bad_luck", f"The dice want {name} to refuse.")

    def step(self, _name: str, run: Run[None, ProcedureData]) -> None:
        assert self.dispatcher is not None
        closure = self.dispatcher.procedure.ask(run.command.branch, run.command.operation)
        assert isinstance(closure, Closure)
        outcome = self._rng.choice(list(closure.outcomes))
        run.outcome = None if outcome == "done" else outcome

    async def side_effecting_step(self, name: str, run: Run[None, ProcedureData]) -> None:
        for _ in range(TURNS):
            await asyncio.sleep(0)
        self.step(name, run)
        if run.command.operation == "connect":
            run.post("placement", "locate")


class DiceCell(DispatcherListener):
    """What a live tour needs of a client, without a bus."""

    simulated = True

    def __init__(self, runs: Blueprint, *, outside: bool = True, refusing: float = 0.2, seed: int = 1) -> None:
        dice = Dice(seed, refusing)
        workflow = scripted(runs, dice, outside=outside)
        self.dispatcher = Dispatcher(workflow, None, SystemClock(), NullRecorder(), self._hold)
        self.dispatcher.add_listener(self)
        dice.dispatcher = self.dispatcher
        self._queues: list[asyncio.Queue[Event]] = []
        self._stops: list[asyncio.Task[bool]] = []
        self._hidden = False
        self._calls = 0
        self._watch = asyncio.ensure_future(self._watch_alignment())

    async def call(self, name: str, arguments: Mapping[str, Any], *, id: str, timeout: float) -> Verdict:
        branch, _, operation = name.partition(".")
        command = Command(id=id, branch=branch, operation=operation, source="bus:test", arguments=dict(arguments))
        self._calls += 1
        try:
            async with asyncio.timeout(timeout):
                return await self.dispatcher.submit(command)
        finally:
            self._calls -= 1

    async def state(self, timeout: float) -> Snapshot:
        await asyncio.sleep(0)
        return self.dispatcher.snapshot()

    async def stop(self, timeout: float) -> None:
        self._stops.append(asyncio.ensure_future(self.dispatcher.stop("bus:test")))

    async def request_device(self, device: str, method: str, arguments: Mapping[str, Any] = NOTHING) -> None:
        if not self.simulated:
            raise UnknownOutcomeError(f"{device} does not answer.")
        if method == "cut_robot" and arguments["cut"]:
            await self._report("link_lost", danger=True)
        elif method == "bump_reference" and arguments["offset_in_body_ref"][0] > 0.0:
            await self._report("reference_moved", danger=True)
        elif method == "occlude":
            self._hidden = arguments["hidden"]
            if self._hidden:
                await self._report("outside")

    async def watch(self) -> AsyncGenerator[Event, None]:
        queue: asyncio.Queue[Event] = asyncio.Queue()
        queue.put_nowait(self.dispatcher.snapshot())
        self._queues.append(queue)
        while True:
            yield await queue.get()

    def never_aligned(self) -> None:
        """The coil is hidden for good."""
        self._watch.cancel()

    async def _watch_alignment(self) -> None:
        """Sees the coil aligned once nothing has been asked for a while."""
        while True:
            quiet = 0
            while quiet < QUIET_TURNS:
                await asyncio.sleep(0)
                quiet = 0 if self._calls or not all(stop.done() for stop in self._stops) else quiet + 1
            joint = self.dispatcher.procedure.joint()
            if joint["placement"] in ("placed", "following") and joint["alignment"] == "0" and not self._hidden:
                await self._report("within")

    async def _report(self, code: str, *, danger: bool = False) -> None:
        await self.dispatcher.report(
            DeviceEvent(device="dice", code=code, text=f"The dice report {code}.", danger=danger)
        )

    async def close(self) -> None:
        self._watch.cancel()
        await asyncio.gather(*self._stops)
        await self.dispatcher.close()

    def on_publish(self, event: Event) -> None:
        for queue in self._queues:
            queue.put_nowait(event)

    async def _hold(self, _latch: bool) -> None:
        pass


async def toured(cell: DiceCell, given: Mapping[str, Any] = EMPTY, seconds: float = 60.0) -> TourReport:
    """The report of a tour that expects RATMS of the cell."""
    done: list[int] = []
    try:
        client = cast(Client, cell)
        report, _ = await tour_live(ratms(), client, TourArguments(given), 1000, seconds, lambda n, _: done.append(n))
        return report
    finally:
        await cell.close()
