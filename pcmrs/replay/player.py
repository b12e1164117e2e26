"""Feeds a dispatcher what once came from outside, row by row, and lets it decide everything else anew."""

from __future__ import annotations

import asyncio
from collections.abc import Coroutine, Sequence
from functools import partial
from typing import Any

import msgspec

from pcmrs.dispatcher import Dispatcher, Workflow
from pcmrs.dispatcher.events import DAEMON, FAIL_STOP, NOT_CONFIRMED, SHUTDOWN
from pcmrs.dispatcher.stops import PENDING, UNNAMED
from pcmrs.fsm import Closure, Denial
from pcmrs.journal import JournalRow, StoredRow
from pcmrs.messages import Command, DeviceEvent, Reason
from pcmrs.replay.answers import Holds, end_activities, end_by_itself
from pcmrs.replay.durability import WINDOW, busy_with, name_of, turned_away
from pcmrs.replay.keys import command_of, is_danger, is_followed_by_report, same_reason
from pcmrs.replay.recorder import ReplayRecorder
from pcmrs.replay.workflow import ReplayWorkflow
from pcmrs.replay.world import ReplayCell, RowsClock
from pcmrs.workflows.cell import Cell
from pcmrs.workflows.data import PlacementData

IDLE = 1.0
"""In simulated time nobody but the feeder waits for a timer: one passes when nobody else has anything to do, s."""


class JournalPlayer:
    """One run of the daemon, decided anew. In an event loop of simulated time.

    Args:
        workflow: With the data that the run began with.
        cell: What is known of the cell.
        rows: What the run's dispatcher wrote.
        lease_required: Whether somebody had to hold the cell.

    Attributes:
        dispatcher: Decides anew.
        recorder: What is decided anew.
        answered: Commands for which the journal said what came of the world.
    """

    def __init__(
        self,
        workflow: Workflow[Cell, PlacementData],
        cell: ReplayCell,
        rows: Sequence[StoredRow],
        *,
        lease_required: bool,
    ) -> None:
        self.recorder = ReplayRecorder(rows)
        self._clock = RowsClock()
        self._rows = [stored.row for stored in rows]
        self._holds = Holds(self._rows)
        self._turned_away = dict(turned_away(self._rows))
        self._workflow = ReplayWorkflow(workflow, self.recorder, self._ask)
        self.dispatcher: Dispatcher[Cell, PlacementData] = Dispatcher(
            self._workflow.workflow,
            cell,
            self._clock,
            self.recorder,
            self._holds.hold,
            lambda _: None,
            release=self._holds.release,
            lease_required=lease_required,
        )
        self._tasks: list[asyncio.Task[Any]] = []
        activities = (
            (f"activity:{activity.run}", f"{name}.{activity.ended}")
            for name, branch in workflow.blueprint.branches.items()
            for activity in branch.activities.values()
        )
        self._endings = frozenset(activities)

    @property
    def answered(self) -> int:
        return len(self._workflow.answered)

    async def feed(self, index: int) -> None:
        """Bring about the row at `index`, if the dispatcher still decides as it did."""
        recorder, row = self.recorder, self._rows[index]
        self._clock.show(row)
        group = self._turned_away_with(index)
        if recorder.decided(index) is None and group:
            await self._submit_all(group[:-1])
            await self._endanger(group[-1])
        elif recorder.decided(index) is None:
            await self._cause(index, row)
        if recorder.decided(index) is None:
            await self._let_the_world_go_on(index, row)

    async def end(self) -> None:
        """End whatever is under way, as the end of the process once did."""
        self.recorder.end()
        for task in [task for task in asyncio.all_tasks() if task is not asyncio.current_task()]:
            task.cancel()
        self._holds.end()
        await self._idle()

    # -- causes -----------------------------------------------------------------------------------------

    async def _cause(self, index: int, row: JournalRow) -> None:
        if row.kind == "device":
            await self._report(index, row)
            return
        self.recorder.release(index)
        await self._idle()
        if (row.source, row.command_id) not in self.recorder.asked:
            if not self._follows_by_itself(row):
                await self._submit_all([*self._running_unseen(index), index])
        else:
            for steps in list(self._workflow.waiting):
                if steps.index == index:
                    steps.end.set()
            await self._idle()

    def _follows_by_itself(self, row: JournalRow) -> bool:
        """Return whether the dispatcher asks for it without being asked: it follows from an event or an activity's end."""
        return is_followed_by_report(row) or (row.source, name_of(row)) in self._endings

    def _running_unseen(self, index: int) -> list[int]:
        """Commands that kept the one at `index` from starting, although their own first rows come later."""
        found = []
        for name in busy_with(self._rows[index]):
            later = range(index + 1, min(index + WINDOW, len(self._rows)))
            first = next((each for each in later if name_of(self._rows[each]) == name), None)
            if first is not None and self._is_new(self._rows[first]) and not self._is_running(name):
                found.append(first)
        return found

    def _is_new(self, row: JournalRow) -> bool:
        return row.kind != "device" and (row.source, row.command_id) not in self.recorder.asked

    def _is_running(self, name: str) -> bool:
        running = {f"{each.branch}.{each.operation}" for each in self.dispatcher.snapshot().running}
        return name in running or self.recorder.holds_locks(name)

    async def _submit_all(self, indices: Sequence[int]) -> None:
        for each in indices:
            if self._is_new(self._rows[each]):
                self._spawn(self.dispatcher.submit(await self._asked(each)))
        await self._idle()

    async def _asked(self, index: int) -> Command:
        """The command at `index`; one that acknowledges comes when the holds that it had to wait for are answered.

        In older journals it names no Stop: it answered the newest one.
        """
        command = command_of(self._rows[index])
        spec = self.dispatcher.procedure.blueprint.find(command.branch, command.operation)
        if spec is None or not spec.unlatches:
            return command
        outcome = self.recorder.outcome_of(command)
        verdict = outcome[1].row.verdict if outcome is not None else None
        code = verdict.reason.code if verdict is not None and verdict.reason is not None else ""
        if code != PENDING and self._holds.answer(index):
            await self._idle()
        if "stop" in command.arguments or code == UNNAMED:
            return command
        named = {**command.arguments, "stop": self.dispatcher.stop_number}
        return msgspec.structs.replace(command, arguments=named)

    def _turned_away_with(self, index: int) -> list[int]:
        """Rows of commands that were rejected because of a Stop, and of that Stop; empty where `index` is none."""
        stop = self._turned_away.get(index)
        return [] if stop is None else list(range(index, stop + 1))

    async def _report(self, index: int, row: JournalRow) -> None:
        source, result = row.source or "", row.result or {}
        if is_danger(row):
            await self._endanger(index)
            return
        self.recorder.release(index)
        await self._idle()
        if not source.startswith("activity:"):
            fields = result.get("fields", {})
            event = DeviceEvent(device=source, code=row.operation or "", text=result.get("text", ""), fields=fields)
            self._spawn(self.dispatcher.report(event))
            await self._idle()

    async def _endanger(self, index: int) -> None:
        """Stop everything as a person, a device or an activity did."""
        row = self._rows[index]
        source, result = row.source or "", row.result or {}
        if row.operation == NOT_CONFIRMED:
            return  # what a hold leads to
        if (source, row.operation) == (DAEMON, FAIL_STOP):
            fields = result.get("fields", {})
            self.dispatcher.fail(Reason(code=fields.get("reason", ""), text=result.get("text", "")))
            await self._idle()
            return
        reason = Reason(code=row.operation or "", text=result.get("text", ""), fields=result.get("fields", {}))
        await self._end_what_had_ended(reason)
        activity = source.removeprefix("activity:")
        if activity != source:
            while self.recorder.release_event(index, source):
                await self._idle()  # it has begun
            end_by_itself(self._workflow.pursued, activity, reason)
        elif source == SHUTDOWN:
            self._spawn(self.dispatcher.close())
        elif source.startswith("device:"):
            device = source.removeprefix("device:")
            event = DeviceEvent(device=device, code=reason.code, text=reason.text, danger=True, fields=reason.fields)
            self._spawn(self.dispatcher.report(event))
        else:
            self._spawn(self.dispatcher.stop(source, reason))
        await self._idle()

    async def _end_what_had_ended(self, reason: Reason) -> None:
        """Steps that are on record with another ending than by this Stop had ended before it."""
        for steps in list(self._workflow.waiting):
            if steps.row is not None and not same_reason(steps.row, reason.code, reason.text):
                steps.end.set()
        await self._idle()

    # -- what the world answers -------------------------------------------------------------------------

    async def _let_the_world_go_on(self, index: int, row: JournalRow) -> None:
        """One after the other, what the dispatcher may be waiting for comes, until it writes the row."""
        recorder = self.recorder
        own_events = partial(recorder.release_event, source=row.source or "")
        holds = self._holds
        answers = (
            own_events,
            self._quieten,
            holds.answer_release,
            holds.answer,
            recorder.release_event,
            recorder.release_any,
        )
        while recorder.decided(index) is None and any(answer(index) for answer in answers):
            await self._idle()
        if recorder.decided(index) is None and self._is_new(row) and (row.source or "").startswith("activity:"):
            await self._submit_all([index])

    def _quieten(self, index: int) -> bool:
        return end_activities(self._workflow.pursued, self._rows[index].source)

    # -- helpers ------------------------------------------------------------------------------------------

    def _ask(self, branch: str, operation: str) -> Closure | Denial:
        return self.dispatcher.procedure.ask(branch, operation)

    def _spawn(self, work: Coroutine[Any, Any, Any]) -> None:
        self._tasks.append(asyncio.get_running_loop().create_task(work))

    @staticmethod
    async def _idle() -> None:
        """Return when nobody has anything to do any more."""
        await asyncio.sleep(IDLE)
