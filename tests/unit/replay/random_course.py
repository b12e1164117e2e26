"""Random courses of a real dispatcher: steps do as told, and a disk in memory is slow at random."""

from __future__ import annotations

import asyncio
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import msgspec

from pcmrs.dispatcher import Activity, Dispatcher, Registry, Run, Workflow
from pcmrs.dispatcher.lease import lapse
from pcmrs.errors import DeviceError, PcmrsError, RefusalError, UnknownOutcomeError
from pcmrs.fsm import Effect
from pcmrs.journal import JournalRow, StoredRow
from pcmrs.journal.rows import GENESIS
from pcmrs.messages import BlueprintTag, Command, DeviceEvent, Reason, Verdict
from pcmrs.messages.identity import Role
from pcmrs.replay._history import DaemonRun
from pcmrs.replay._world import RowsClock
from pcmrs.service.restart.recorder import JournalRecorder
from pcmrs.workflows.data import PlacementData
from tests.support.ratms_oracle import EVENT_OPERATIONS, all_operations
from tests.support.shipped import shipped_blueprint

RATMS = shipped_blueprint("ratms")
TAG = BlueprintTag(id=RATMS.id, version=RATMS.version, hash=RATMS.hash)
ENDS = " ends"
"""After its name: what an activity waits for when it was told to end."""
WORLDLY_BRANCHES = ("digitization", "robot", "placement")
OPERATIONS = all_operations()
EVENTS = {(branch, name) for branch, names in EVENT_OPERATIONS.items() for name in names}


def is_event(index: int) -> bool:
    """Whether the operation with this number is an event."""
    return OPERATIONS[index % len(OPERATIONS)] in EVENTS


class Numbers(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Arguments of every operation that takes any."""

    values: list[float] = []


class Notes(PlacementData, frozen=True, kw_only=True):
    """Data that shows what was committed, by branch: an operation sees what is durable of the others only."""

    registration: tuple[str, ...] = ()
    toolplan: tuple[str, ...] = ()
    alignment: tuple[str, ...] = ()
    joints: float = 0.0


class Cell:
    """The world, as far as checks look at it."""

    def __init__(self) -> None:
        self.joints = 0.0


@dataclass
class Waiting:
    """A step or activity that goes on until the course ends it."""

    name: str
    end: asyncio.Future[str | None]


class Course:
    """A dispatcher, its journal, and what it waits for."""

    def __init__(self, workflow: Workflow[Any, Any] | None = None, session: str = "run-1") -> None:
        self.cell = Cell()
        self.rows: list[StoredRow] = []
        self.waiting: list[Waiting] = []
        self.holds: list[asyncio.Future[bool]] = []
        self._durable: list[asyncio.Future[int]] = []
        self._tasks: list[asyncio.Task[Any]] = []
        self._number = 0
        self._ending = False
        self.workflow = workflow or make_workflow(self)
        self.reader = self
        clock = RowsClock()
        recorder = JournalRecorder(self, clock, session, TAG)  # type: ignore[arg-type]
        self._spawn(recorder.started({"procedure": {}}, "calibration"))
        self.dispatcher = Dispatcher(self.workflow, self.cell, clock, recorder, self._hold)

    # -- the journal ------------------------------------------------------------------------------------

    def append(self, rows: Sequence[JournalRow]) -> asyncio.Future[int]:
        durable: asyncio.Future[int] = asyncio.get_running_loop().create_future()
        for row in rows:
            sequence = len(self.rows) + 1
            self.rows.append(StoredRow(sequence=sequence, row=row, previous_hash=GENESIS, hash=GENESIS))
        self._durable.append(durable)
        if self._ending:
            durable.set_result(len(self.rows))
        return durable

    def verdict_of(self, source: str, command_id: str) -> Verdict | None:
        asked = ((each.row.source, each.row.command_id, each.row.verdict) for each in self.rows)
        return next((verdict for at, by, verdict in asked if verdict and (at, by) == (source, command_id)), None)

    def decided(self) -> Iterator[tuple[str, str]]:
        rows = (each.row for each in self.rows if each.row.verdict is not None)
        return ((row.source or "", row.command_id or "") for row in rows)

    # -- what a course is made of -----------------------------------------------------------------------

    def submit(self, index: int, value: float, source: str = "bus:test", repeat: bool = False) -> None:
        if self.dispatcher._locks.waiting:
            return  # that somebody came while another waited is not on record: see docs/replay.md
        branch, operation = OPERATIONS[index % len(OPERATIONS)]
        self._number += 0 if repeat and self._number else 1
        payload = RATMS.branches[branch].operations[operation].payload
        arguments = {} if payload == "none" else {"values": [value]}
        by = "detector:test" if is_event(index) else source
        command = Command(id=f"c{self._number}", branch=branch, operation=operation, source=by, arguments=arguments)
        self._spawn(self.dispatcher.submit(command))

    def ask(self, user: str, role: Role, name: str, arguments: dict[str, Any]) -> None:
        """Somebody asks by name, on the bus."""
        self._number += 1
        branch, operation = name.split(".")
        command = Command(
            id=f"c{self._number}",
            branch=branch,
            operation=operation,
            source=f"bus:{user}",
            user=user,
            role=role,
            arguments=arguments,
        )
        self._spawn(self.dispatcher.submit(command))

    def lose_holder(self, *, moving: bool) -> None:
        holder = self.dispatcher.lease.holder or ""
        self._spawn(self.dispatcher.report(lapse(holder, 10.0, moving=moving)))

    def stop(self, source: str) -> None:
        self._spawn(self.dispatcher.stop(source))

    def report(self, code: str, danger: bool) -> None:
        event = DeviceEvent(device="robot", code=code, text=f"It says {code}.", danger=danger)
        self._spawn(self.dispatcher.report(event))

    def fail(self) -> None:
        self.dispatcher.fail(Reason(code="internal_error", text="Something that cannot be."))

    def flush(self, count: int) -> None:
        for durable in [each for each in self._durable if not each.done()][:count]:
            durable.set_result(len(self.rows))

    def end_one(self, index: int, ending: str | None) -> bool:
        """Ends one of what goes on; returns whether it was an activity, which ends by itself then."""
        waiting = [each for each in self.waiting if not each.end.done()]
        if not waiting:
            return False
        ended = waiting[index % len(waiting)]
        ended.end.set_result(ending)
        return "." not in ended.name

    def confirm(self, *, stands: bool) -> None:
        for hold in self.holds:
            if not hold.done():
                hold.set_result(stands)
        self.holds.clear()

    async def close(self) -> None:
        """The daemon ends in order."""
        self._ending = True
        for waiting in self.waiting:
            if waiting.name.endswith(ENDS) and not waiting.end.done():
                waiting.end.set_result(None)
        self.flush(len(self._durable))
        self.confirm(stands=True)
        await asyncio.sleep(1.0)  # in which order things end within one turn of the loop no journal tells
        await self.dispatcher.close()
        await asyncio.gather(*self._tasks)

    async def crash(self) -> None:
        """The process ends at once: nothing more is journalled."""
        rows = list(self.rows)
        await self.close()
        self.rows = rows

    def runs(self) -> list[DaemonRun]:
        return [DaemonRun(TAG, self.rows)]

    # -- what the dispatcher calls ----------------------------------------------------------------------

    async def wait(self, name: str) -> str | None:
        if self._ending:
            return None
        waiting = Waiting(name, asyncio.get_running_loop().create_future())
        self.waiting.append(waiting)
        try:
            return await waiting.end
        finally:
            self.waiting.remove(waiting)

    async def _hold(self, _latch: bool) -> None:
        if self._ending:
            return
        hold: asyncio.Future[bool] = asyncio.get_running_loop().create_future()
        self.holds.append(hold)
        if not await hold:
            raise DeviceError("It does not answer.")

    def _spawn(self, work: Any) -> None:
        self._tasks.append(asyncio.get_running_loop().create_task(work))


def make_workflow(course: Course) -> Workflow[Any, Any]:
    """The RATMS blueprint; checks look at arguments, data or the world, and steps wait for the course."""
    registry: Registry[Any, Any] = Registry()

    async def world_step(run: Run[Any, Notes]) -> None:
        ending = await course.wait(f"{run.command.branch}.{run.command.operation}")
        _end(run, ending)
        run.keep(joints=course.cell.joints)

    async def go_on(act: Activity[Any, Notes]) -> None:
        try:
            ending = await course.wait(act.name)
        except asyncio.CancelledError:
            await course.wait(act.name + ENDS)
            raise
        _raise(ending)

    for name, branch in RATMS.branches.items():
        registry.activities |= dict.fromkeys((each.run for each in branch.activities.values()), go_on)
        for spec in branch.operations.values():
            registry.checks |= dict.fromkeys(spec.checks, check)
            side_effecting = name in WORLDLY_BRANCHES
            registry.steps |= dict.fromkeys(spec.steps, world_step if side_effecting else data_step)
            if side_effecting:
                registry.side_effecting.update(spec.steps)
            if spec.payload != "none":
                registry.payload(spec.payload, Numbers)
    return Workflow(RATMS, registry, Notes(), _settle)


def check(run: Run[Any, Notes]) -> None:
    """Refuses by argument, by data, or by what it sees."""
    value = next(iter(getattr(run.payload, "values", [])), 0.0)
    if value < 0.0:
        raise RefusalError("negative", "It is negative.", value=value)
    if value > 10.0 and len(getattr(run.data, run.command.branch, ())) % 2:
        raise RefusalError("odd", "The marks are odd.")
    if 5.0 < value <= 10.0 and run.cell.joints > 0.5:
        raise RefusalError("joints_large", "The joints are large.")


def data_step(run: Run[Any, Notes]) -> None:
    """Changes the data by what is known."""
    _end(run, None)
    branch = run.command.branch
    run.keep(**{branch: (*getattr(run.data, branch), run.command.operation)[-3:]})


def _end(run: Run[Any, Notes], ending: str | None) -> None:
    _raise(ending)
    outcomes = RATMS.branches[run.command.branch].operations[run.command.operation].outcomes
    if outcomes:
        run.outcome = ending if ending in outcomes else next(iter(outcomes))


def _raise(ending: str | None) -> None:
    if ending == "failed":
        raise DeviceError("The device says no.")
    if ending == "unknown":
        raise UnknownOutcomeError("Nobody knows.")
    if ending == "raised":
        raise PcmrsError("Something else.")


def _settle(data: Notes, states: Mapping[str, str], effects: Sequence[Effect]) -> Notes:
    return msgspec.structs.replace(data, registration=()) if states["registration"] == "000" else data


__all__ = ["RATMS", "TAG", "Course", "Reason", "make_workflow"]
