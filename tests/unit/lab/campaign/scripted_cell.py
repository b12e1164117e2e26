"""A cell, its devices and the lab that lends it, without daemon and bus: a fault row runs against what a test says."""

from __future__ import annotations

import asyncio
import random
import signal
from collections.abc import AsyncIterator, Awaitable, Callable, Sequence
from contextlib import asynccontextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import Any, TypeVar, cast

import pytest

from pcmrs.journal import JournalRow
from pcmrs.messages import PoseMessage, SceneTruth
from pcmrs.planner import PlannerVerdict
from pcmrs.simulated_time.clock import SimulatedClock
from pcmrs.testing.cell import RunningCell
from pcmrs.testing.loop import run_on_simulated_loop
from pcmrs_lab.campaign import without_guard
from pcmrs_lab.campaign.lab import Lab
from tests.unit.lab.scripted_client import ScriptedClient

T = TypeVar("T")

IDENTITY = (1.0, 0.0, 0.0, 0.0)
AT_ORIGIN = PoseMessage(position=(0.0, 0.0, 0.0), quat_wxyz=IDENTITY)
CLOCKED = (
    "waiting",
    "delays",
    "signs",
    "robot_signs",
    "operating",
    "faults.operator",
    "faults.process",
    "faults.clock",
)
"""Modules of the campaign that read the machine's clock."""


def run(monkeypatch: pytest.MonkeyPatch, work: Awaitable[T]) -> T:
    """Runs work of a campaign in simulated time, so that its waits cost nothing; its threads run at once."""
    monkeypatch.setattr("asyncio.to_thread", _at_once)
    for module in CLOCKED:
        clock = f"pcmrs_lab.campaign.{module}.SystemClock"
        monkeypatch.setattr(clock, lambda: SimulatedClock(asyncio.get_running_loop()))
    return run_on_simulated_loop(work)


async def _at_once(call: Callable[..., Any], *given: Any) -> Any:
    return call(*given)


class ScriptedProcess:
    """A process that only keeps what is sent to it; SIGKILL and SIGTERM end it."""

    def __init__(self) -> None:
        self.pid = 4711
        self.returncode: int | None = None
        self.signals: list[int] = []

    def send_signal(self, number: int) -> None:
        self.signals.append(number)
        if number in (signal.SIGKILL, signal.SIGTERM):
            self.returncode = -number

    def terminate(self) -> None:
        self.send_signal(signal.SIGTERM)

    def kill(self) -> None:
        self.send_signal(signal.SIGKILL)

    async def wait(self) -> int:
        while self.returncode is None:  # noqa: ASYNC110 - ended by a signal in between
            await asyncio.sleep(0.1)
        return self.returncode


class ScriptedScene:
    """A scene whose tool is at these places, one after the other; the last one for good.

    Attributes:
        asked: What was injected, in order.
        reference: Where the reference on the body is.
        patient: Where the patient is in the frame of the reference.
        tip: Where the tip of the pointer is; None while the hand is away.
    """

    def __init__(self, *places: tuple[float, float, float]) -> None:
        self.places = list(places or [(0.0, 0.0, 0.0)])
        self.reference = self.patient = AT_ORIGIN
        self.tip: tuple[float, float, float] | None = None
        self.asked: list[Any] = []
        self.errors: dict[str, Exception] = {}

    async def truth(self) -> SceneTruth:
        place = self.places.pop(0) if self.places[1:] else self.places[0]
        coil = PoseMessage(position=place, quat_wxyz=IDENTITY)
        return SceneTruth(
            tracker_from_coil=coil,
            tracker_from_body_ref=self.reference,
            body_ref_from_image=self.patient,
            tip_in_tracker=self.tip,
        )

    async def inject(self, fault: str, arguments: dict[str, Any]) -> None:
        self.asked.append((fault, arguments))
        if fault in self.errors:
            raise self.errors[fault]

    async def displace_touch(self, index: int, offset: tuple[float, float, float]) -> None:
        self.asked.append((index, offset))

    async def reseed(self, seed: int) -> None:
        self.asked.append(("reseed", seed))


class ScriptedBus:
    """A bus whose counters and answers a test sets.

    Attributes:
        published: Keys and messages, in order.
        answers: Of requests, by key.
        handlers: Of subscriptions, by key.
    """

    def __init__(self) -> None:
        self.counts: dict[str, int] = {"bus.ignored": 0, "bus.replaced": 0}
        self.published: list[tuple[str, Any]] = []
        self.answers: dict[str, Any] = {}
        self.handlers: dict[str, Callable[[str, Any], None]] = {}

    def counters(self) -> dict[str, int]:
        return dict(self.counts)

    def publish(self, key: str, message: Any) -> None:
        self.published.append((key, message))

    async def request(self, key: str, message: Any, kind: type, timeout: float) -> Any:
        found = self.answers[key]
        if callable(found):
            found = found(message)
        if isinstance(found, Exception):
            raise found
        return found

    def subscribe(self, key: str, kind: type, handler: Callable[[str, Any], None]) -> Callable[[], Awaitable[None]]:
        self.handlers[key] = handler

        async def end() -> None:
            self.handlers.pop(key, None)

        return end


class ScriptedPlanner:
    """A planner's link that answers with these verdicts, by command; what it is told nothing of is accepted."""

    def __init__(self) -> None:
        self.verdicts: dict[str, PlannerVerdict] = {}
        self.asked: list[tuple[Any, ...]] = []

    async def command(self, name: str, *values: Any, timeout: float = 0.0) -> PlannerVerdict:
        self.asked.append((name, *values))
        return self.verdicts.get(name, PlannerVerdict("accepted", "toolplan", "1", None, ()))

    async def plan_landmarks(self, _points: Any) -> None:
        self.asked.append(("plan_landmarks",))

    async def stop(self) -> None:
        self.asked.append(("stop",))


class ScriptedCell:
    """A running cell of parts that a test scripts."""

    def __init__(self, folder: Path = Path("cell1"), **branches: str) -> None:
        self.client = ScriptedClient(**branches)
        self.process = ScriptedProcess()
        self.scene = ScriptedScene()
        self.bus = ScriptedBus()
        self.planner = ScriptedPlanner()
        self.folder, self.name, self.log, self.settings = folder, folder.name, "", ("cell.rate=1",)
        links = {"planner": ("127.0.0.1", 9), "tcp": ("127.0.0.1", 9)}
        journal = str(folder / "ratms.sqlite")
        self.ready = SimpleNamespace(
            endpoint="tcp/127.0.0.1:9", prefix="pcmrs/lab/cell1", links=links, journal=journal, folder=str(folder)
        )

    @property
    def as_cell(self) -> RunningCell:
        return cast(RunningCell, self)

    def rows(self, after: int = 0) -> list[JournalRow]:
        return self.client.rows[after:]

    def last_row(self) -> int:
        return len(self.client.rows)


class ScriptedLab:
    """A lab that lends these cells, one after the other; the last one for good.

    Attributes:
        started: Settings of the daemons, in order.
        refusals: Exit status and error of daemons that must refuse to start, in order.
        unguarded: The cell of a daemon without some guards.
        removed: Names of the guards that such daemons did not have, in order.
    """

    def __init__(self, folder: Path, *cells: ScriptedCell) -> None:
        self.seed, self.folder, self.random = 1, folder, random.Random(1)
        self.cells = list(cells)
        self.started: list[tuple[str, ...]] = []
        self.refusals: list[tuple[int, str]] = []
        self.unguarded = ScriptedCell()
        self.removed: list[str] = []

    @property
    def as_lab(self) -> Lab:
        return cast(Lab, self)

    @asynccontextmanager
    async def daemon(self, *overrides: str, prefix: Sequence[str] = (), **_: Any) -> AsyncIterator[ScriptedCell]:
        self.started.append(overrides)
        if without_guard.PROGRAM in prefix:
            self.removed += prefix[-1].split(",")
            yield self.unguarded
        else:
            yield self.cells.pop(0) if self.cells[1:] else self.cells[0]

    def cell(self, *overrides: str, **_: Any) -> Any:
        return self.daemon(*overrides)

    async def start_refused(self, *overrides: str, folder: Path | None = None) -> tuple[int, str]:
        self.started.append(overrides)
        return self.refusals.pop(0)
