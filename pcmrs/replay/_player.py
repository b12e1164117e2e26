"""Player of a journal: it gives a dispatcher all external inputs, row by row; the dispatcher decides the rest again."""

from __future__ import annotations

import asyncio
from collections.abc import Coroutine, Sequence
from functools import partial
from typing import Any

import msgspec

from pcmrs.dispatcher import Dispatcher, Workflow
from pcmrs.dispatcher.events import DAEMON, FAIL_STOP, NOT_CONFIRMED, SCENE_NOT_CLEAR, SHUTDOWN
from pcmrs.dispatcher.stops import PENDING
from pcmrs.fsm import Closure, Denial
from pcmrs.journal import JournalRow, StoredRow
from pcmrs.messages import STOP_NOT_NAMED, Command, DeviceEvent, Reason
from pcmrs.replay._answers import Holds, end_activities, end_unrequested
from pcmrs.replay._durability import WINDOW, name_of, rejected_by_stop, running_operations
from pcmrs.replay._keys import command_of, is_danger, is_followed_by_report, same_reason
from pcmrs.replay._recorder import ReplayRecorder
from pcmrs.replay._workflow import ReplayWorkflow
from pcmrs.replay._world import ReplayCell, RowsClock
from pcmrs.workflows.cell import Cell
from pcmrs.workflows.data import PlacementData

IDLE = 1.0
"""Timer of the player, s. No other task waits in simulated time, so it expires when all of them are idle."""
MOST_ROUNDS = 10
"""Largest number of times that tasks are cancelled at the end of a run."""


class JournalPlayer:
    """Replay of one run of the daemon, in an event loop of simulated time.

    Args:
        workflow: Workflow with the data with which the run started.
        cell: Known attributes of the cell.
        rows: Rows that the run's dispatcher wrote.
        lease_required: True if commands needed the lease of the cell.

    Attributes:
        dispatcher: Dispatcher that decides again.
        recorder: Replayed decisions.
        answered: Number of commands that the journal answered in place of devices.
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
        self._rejected_by_stop = dict(rejected_by_stop(self._rows))
        self._workflow = ReplayWorkflow(workflow, self.recorder, self._ask)
        self.dispatcher: Dispatcher[Cell, PlacementData] = Dispatcher(
            self._workflow.workflow,
            cell,
            self._clock,
            self.recorder,
            self._holds.hold,
            release=self._holds.release,
            lease_required=lease_required,
            limits=cell.settings.limits,
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
        """Cause the row at `index`, if the dispatcher still decides as it did."""
        recorder, row = self.recorder, self._rows[index]
        self._clock.show(row)
        group = self._rejected_with(index)
        if recorder.decided(index) is None and group:
            await self._submit_all(group[:-1])
            await self._stop(group[-1])
        elif recorder.decided(index) is None:
            await self._cause(index, row)
        if recorder.decided(index) is None:
            await self._give_answers(index, row)

    async def end(self) -> None:
        """End all operations and activities in progress, as the end of the process did."""
        self.recorder.end()
        for _ in range(MOST_ROUNDS):
            others = [task for task in asyncio.all_tasks() if task is not asyncio.current_task()]
            if not others:
                return
            # One that waits for an answer in its end is cancelled again, and may have started another one.
            for task in others:
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
        if (row.source, row.command_id) not in self.recorder.submitted:
            if not self._follows_by_itself(row):
                await self._submit_all([*self._running_undecided(index), index])
        else:
            for steps in list(self._workflow.waiting):
                if steps.index == index:
                    steps.end.set()
            await self._idle()

    def _follows_by_itself(self, row: JournalRow) -> bool:
        """Return whether the dispatcher itself submits the command, after an event or the end of an activity."""
        return is_followed_by_report(row) or (row.source, name_of(row)) in self._endings

    def _running_undecided(self, index: int) -> list[int]:
        """Return the commands that made the one at `index` busy, although their own first rows come later."""
        found = []
        for name in running_operations(self._rows[index]):
            later = range(index + 1, min(index + WINDOW, len(self._rows)))
            of_name = (each for each in later if name_of(self._rows[each]) == name)
            first = next((each for each in of_name if not running_operations(self._rows[each])), None)
            if first is not None and self._is_new(self._rows[first]) and not self._is_running(name):
                found.append(first)
        return found

    def _is_new(self, row: JournalRow) -> bool:
        return row.kind != "device" and (row.source, row.command_id) not in self.recorder.submitted

    def _is_running(self, name: str) -> bool:
        running = {f"{each.branch}.{each.operation}" for each in self.dispatcher.snapshot().running}
        return name in running or self.recorder.holds_locks(name)

    async def _submit_all(self, indices: Sequence[int]) -> None:
        for each in indices:
            if self._is_new(self._rows[each]):
                self._spawn(self._submit(await self._command(each), self._rows[each]))
        await self._idle()

    async def _submit(self, command: Command, row: JournalRow) -> None:
        """Submit a command, as the scene allowed it: what the cameras saw then is known by what was rejected."""
        reason = row.verdict.reason if row.verdict is not None else None
        barred = reason is not None and reason.code == SCENE_NOT_CLEAR
        self.dispatcher.bar_motion(reason if barred else None)
        await self.dispatcher.submit(command)

    async def _command(self, index: int) -> Command:
        """Return the command at `index`; before one that acknowledges, answer the holds that it had to wait for.

        In older journals it names no Stop, and acknowledged the newest one.
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
        if "stop" in command.arguments or code == STOP_NOT_NAMED:
            return command
        named = {**command.arguments, "stop": self.dispatcher.stop_number}
        return msgspec.structs.replace(command, arguments=named)

    def _rejected_with(self, index: int) -> list[int]:
        """Return the rows of commands that a Stop rejected, and of that Stop; empty if `index` is not the first one."""
        stop = self._rejected_by_stop.get(index)
        return [] if stop is None else list(range(index, stop + 1))

    async def _report(self, index: int, row: JournalRow) -> None:
        source, result = row.source or "", row.result or {}
        if is_danger(row):
            await self._stop(index)
            return
        self.recorder.release(index)
        await self._idle()
        if not source.startswith(("activity:", "timer:")):  # the dispatcher itself reports what follows from a commit
            fields = result.get("fields", {})
            event = DeviceEvent(device=source, code=row.operation or "", text=result.get("text", ""), fields=fields)
            self._spawn(self.dispatcher.report(event))
            await self._idle()

    async def _stop(self, index: int) -> None:
        """Stop the cell as a person, a device or an activity did."""
        row = self._rows[index]
        source, result = row.source or "", row.result or {}
        if row.operation == NOT_CONFIRMED:
            return  # it follows from a hold
        if (source, row.operation) == (DAEMON, FAIL_STOP):
            fields = result.get("fields", {})
            self.dispatcher.fail(Reason(code=fields.get("reason", ""), text=result.get("text", "")))
            await self._idle()
            return
        reason = Reason(code=row.operation or "", text=result.get("text", ""), fields=result.get("fields", {}))
        await self._end_finished_steps(reason)
        activity = source.removeprefix("activity:")
        if activity != source:
            while self.recorder.release_event(index, source):
                await self._idle()  # its start is durable
            end_unrequested(self._workflow.activities, activity, reason)
        elif source == SHUTDOWN:
            self._spawn(self.dispatcher.close())
        elif source.startswith("device:"):
            device = source.removeprefix("device:")
            event = DeviceEvent(device=device, code=reason.code, text=reason.text, danger=True, fields=reason.fields)
            self._spawn(self.dispatcher.report(event))
        else:
            self._spawn(self.dispatcher.stop(source, reason))
        await self._idle()

    async def _end_finished_steps(self, reason: Reason) -> None:
        """End the steps that were journalled with another end than this Stop: they ended before it."""
        for steps in list(self._workflow.waiting):
            if steps.row is not None and not same_reason(steps.row, reason.code, reason.text):
                steps.end.set()
        await self._idle()

    # -- what the world answers -------------------------------------------------------------------------

    async def _give_answers(self, index: int, row: JournalRow) -> None:
        """Give the answers that the dispatcher may wait for, one after the other, until it writes the row."""
        recorder = self.recorder
        own_events = partial(recorder.release_event, source=row.source or "")
        holds = self._holds
        answers = (
            own_events,
            self._end_activities,
            holds.answer_release,
            holds.answer,
            recorder.release_event,
            recorder.release_any,
        )
        while recorder.decided(index) is None and any(answer(index) for answer in answers):
            await self._idle()
        if recorder.decided(index) is None and self._is_new(row) and (row.source or "").startswith("activity:"):
            await self._submit_all([index])

    def _end_activities(self, index: int) -> bool:
        return end_activities(self._workflow.activities, self._rows[index].source)

    # -- helpers ------------------------------------------------------------------------------------------

    def _ask(self, branch: str, operation: str) -> Closure | Denial:
        return self.dispatcher.procedure.ask(branch, operation)

    def _spawn(self, work: Coroutine[Any, Any, Any]) -> None:
        self._tasks.append(asyncio.get_running_loop().create_task(work))

    @staticmethod
    async def _idle() -> None:
        """Return when all other tasks are idle."""
        await asyncio.sleep(IDLE)
