"""A run with timers is replayed: they begin and end with the same commits, and their events come from the rows."""

from __future__ import annotations

import asyncio
from typing import Any

import msgspec

from pcmrs.clock import SystemClock
from pcmrs.dispatcher import Dispatcher, Registry, Run, Workflow
from pcmrs.journal import StoredRow
from pcmrs.journal.rows import GENESIS, JournalRow
from pcmrs.messages import BlueprintTag, Command
from pcmrs.replay._history import DaemonRun
from pcmrs.replay.replay import ReplayReport, replay_runs
from pcmrs.service.restart.recorder import JournalRecorder
from pcmrs.simulated_time.clock import SimulatedClock
from pcmrs.simulated_time.loop import SimulatedLoop
from pcmrs.workflows.data import PlacementData
from tests.unit.fsm.timed_workflow import timed_blueprint

BLUEPRINT = timed_blueprint()
TAG = BlueprintTag(id=BLUEPRINT.id, version=BLUEPRINT.version, hash=BLUEPRINT.hash)


def nothing(_run: Run[Any, Any]) -> None:
    """A step without an effect."""


def workflow() -> Workflow[Any, Any]:
    registry: Registry[Any, Any] = Registry()
    for branch in BLUEPRINT.branches.values():
        for spec in branch.operations.values():
            registry.steps |= dict.fromkeys(spec.steps, nothing)
    return Workflow(BLUEPRINT, registry, PlacementData(), lambda data, _states, _effects: data)


class Disk:
    """A journal in memory, on which everything is durable at once."""

    def __init__(self) -> None:
        self.rows: list[StoredRow] = []
        self.reader = self

    def append(self, rows: list[JournalRow]) -> asyncio.Future[int]:
        for row in rows:
            stored = StoredRow(sequence=len(self.rows) + 1, row=row, previous_hash=GENESIS, hash=GENESIS)
            self.rows.append(stored)
        durable: asyncio.Future[int] = asyncio.get_running_loop().create_future()
        durable.set_result(len(self.rows))
        return durable

    def verdict_of(self, _source: str, _command_id: str) -> None:
        return None

    def decided(self) -> list[tuple[str, str]]:
        return []


async def recorded(*course: str | float) -> list[StoredRow]:
    """The rows of a course of commands and waits, s."""
    clock, disk = SimulatedClock(asyncio.get_running_loop()), Disk()
    recorder = JournalRecorder(disk, clock, "run-1", TAG)  # type: ignore[arg-type]
    await recorder.started({"procedure": {"limits": {"rest_s": 7}}}, "calibration")

    async def hold(_latch: bool) -> None:
        await asyncio.sleep(0)

    dispatcher: Dispatcher[Any, Any] = Dispatcher(workflow(), None, clock, recorder, hold, limits={"rest_s": 7})
    for number, each in enumerate(course):
        if isinstance(each, float):
            await clock.sleep(each)
        else:
            branch, operation = each.split(".")
            command = Command(id=f"c{number}", branch=branch, operation=operation, source="bus:test")
            await dispatcher.submit(command)
    await dispatcher.close()
    return disk.rows


def rows_of(*course: str | float) -> list[StoredRow]:
    with asyncio.Runner(loop_factory=SimulatedLoop) as runner:
        return runner.run(recorded(*course))


def replayed(rows: list[StoredRow]) -> ReplayReport:
    return replay_runs("timed", [DaemonRun(TAG, rows)], lambda _tag: workflow(), SystemClock())


COURSE: tuple[str | float, ...] = (
    *("session.begin", "tool.place", "pulse.arm", "pulse.give", 8.0, "tool.nudge", 300.0),
    *(301.0, "tool.withdraw", "session.end"),
)


def test_a_run_with_timers_is_decided_alike() -> None:
    rows = rows_of(*COURSE)
    by = [stored.row.source for stored in rows if stored.row.kind == "outcome"]
    assert (by.count("timer:tool.idle"), by.count("timer:pulse.rest"), by.count("timer:session.remind")) == (1, 1, 10)
    report = replayed(rows)
    assert report.differences == []
    assert report.rows > 20


def test_an_event_that_the_timers_did_not_post_is_found() -> None:
    """A row of an event that the states do not allow there."""
    rows = rows_of("tool.place", 601.0, "tool.withdraw")
    (index,) = (i for i, each in enumerate(rows) if each.row.source == "timer:tool.idle" and each.row.kind == "outcome")
    moved = [*rows[:1], rows[index], *rows[1:index], *rows[index + 1 :]]
    renumbered = [msgspec.structs.replace(each, sequence=number) for number, each in enumerate(moved, 1)]
    assert replayed(renumbered).differences
