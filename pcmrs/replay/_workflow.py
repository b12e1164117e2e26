"""A workflow in which the journal answers in place of devices, frames and clock."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import msgspec

from pcmrs.dispatcher import Activity as AnyActivity
from pcmrs.dispatcher import Registry, Workflow
from pcmrs.dispatcher import Run as AnyRun
from pcmrs.errors import PcmrsError, RefusalError, UnknownOutcomeError
from pcmrs.fsm import Closure, Denial
from pcmrs.journal import JournalRow
from pcmrs.messages import Reason
from pcmrs.replay._recorder import ReplayRecorder
from pcmrs.replay._world import NotJournalledError, ReplayClock
from pcmrs.workflows.cell import Cell
from pcmrs.workflows.data import PlacementData

Run = AnyRun[Cell, PlacementData]
Activity = AnyActivity[Cell, PlacementData]
CommandKey = tuple[str, str]
"""Source and id of a command."""

UNKNOWN = UnknownOutcomeError.code


@dataclass(frozen=True, eq=False)
class Steps:
    """Steps of an operation with side effects; they wait until they may end as journalled.

    Attributes:
        run: Run of the operation.
        index: Index of the journalled outcome; None if there was none.
        row: That outcome.
        end: Set to let them end.
    """

    run: Run
    index: int | None
    row: JournalRow | None
    end: asyncio.Event


@dataclass(frozen=True, eq=False)
class PendingActivity:
    """A running activity; it ends when the journal shows its end, requested or not.

    Attributes:
        name: Name of the activity.
        unrequested_end: Done when it ends without a request.
        end_requested: Set when the dispatcher has asked it to end.
        end_allowed: Done when it may follow the request.
    """

    name: str
    unrequested_end: asyncio.Future[None]
    end_requested: asyncio.Event
    end_allowed: asyncio.Future[None]


class ReplayWorkflow:
    """A workflow whose checks and steps on data really run; the journal answers those that need devices or the clock.

    Args:
        workflow: The real workflow.
        recorder: Source of the journalled outcomes.
        ask: `Procedure.ask` of the dispatcher that decides again.

    Attributes:
        workflow: The workflow with replaced checks, steps and activities.
        waiting: Operations whose steps wait.
        activities: Running activities.
        answered: Commands that the journal answered in place of devices.
    """

    def __init__(
        self,
        workflow: Workflow[Cell, PlacementData],
        recorder: ReplayRecorder,
        ask: Callable[[str, str], Closure | Denial],
    ) -> None:
        real = workflow.registry
        registry: Registry[Cell, PlacementData] = Registry(payloads=real.payloads, side_effecting=real.side_effecting)
        registry.checks = {name: partial(self._check, name, check) for name, check in real.checks.items()}
        registry.steps = {name: partial(self._step, step) for name, step in real.steps.items()}
        registry.activities = dict.fromkeys(real.activities, self._run_activity)
        self.workflow = replace(workflow, registry=registry)
        self.waiting: list[Steps] = []
        self.activities: list[PendingActivity] = []
        self.answered: set[CommandKey] = set()
        self._side_effecting = real.side_effecting
        self._committed: set[CommandKey] = set()
        self._recorder = recorder
        self._ask = ask

    # -- checks and steps -----------------------------------------------------------------------------

    def _check(self, name: str, check: Callable[[Run], None], run: Run) -> None:
        run.clock = ReplayClock()
        try:
            check(run)
        except NotJournalledError:
            self.answered.add(_command_key(run))
            self._refuse_as_journalled(name, run)
        except PcmrsError:
            raise
        except Exception:
            if _command_key(run) not in self.answered:
                raise
            self._refuse_as_journalled(name, run)  # it lacks a result that an earlier check could not compute

    def _refuse_as_journalled(self, name: str, run: Run) -> None:
        _, row = self._journalled(run)
        reason = row.verdict.reason if row is not None and row.verdict is not None else None
        if reason is not None and reason.fields.get("check") == name:
            raise _refusal(reason)

    def _step(self, step: Callable[[Run], Awaitable[None] | None], run: Run) -> Awaitable[None] | None:
        run.clock = ReplayClock()
        spec = self.workflow.blueprint.branches[run.command.branch].operations[run.command.operation]
        if not self._side_effecting.isdisjoint(spec.steps):
            return self._wait(run)
        if _command_key(run) not in self.answered:
            try:
                return step(run)
            except NotJournalledError:
                self.answered.add(_command_key(run))
        self._end_as_journalled(run, self._journalled(run)[1])
        return None

    async def _wait(self, run: Run) -> None:
        """Wait for the end of all steps of an operation, and end them as journalled."""
        if _command_key(run) in self._committed:
            return
        self.answered.add(_command_key(run))
        index, row = self._journalled(run)
        steps = Steps(run, index, row, asyncio.Event())
        self.waiting.append(steps)
        try:
            await steps.end.wait()
        finally:
            self.waiting.remove(steps)
        self._end_as_journalled(run, row)
        self._committed.add(_command_key(run))

    def _end_as_journalled(self, run: Run, row: JournalRow | None) -> None:
        verdict = row.verdict if row is not None else None
        if row is None or verdict is None:
            return
        if verdict.decision != "accepted" and verdict.reason is not None:
            raise _ending(verdict.decision, verdict.reason)
        if row.result:
            run.keep(**_typed(run.data, row.result))
        run.outcome = self._outcome(run, row)

    def _outcome(self, run: Run, row: JournalRow) -> str | None:
        """Return the declared outcome that leads to the journalled states; None if there is none."""
        closure, after = self._ask(run.command.branch, run.command.operation), row.states or {}
        if isinstance(closure, Denial):
            return None
        fitting = (name for name, change in closure.outcomes.items() if change.targets.items() <= after.items())
        return next(fitting, None)

    def _journalled(self, run: Run) -> tuple[int | None, JournalRow | None]:
        found = self._recorder.outcome_of(run.command)
        return (None, None) if found is None else (found[0], found[1].row)

    # -- activities -----------------------------------------------------------------------------------

    async def _run_activity(self, act: Activity) -> None:
        loop = asyncio.get_running_loop()
        pending = PendingActivity(act.name, loop.create_future(), asyncio.Event(), loop.create_future())
        self.activities.append(pending)
        try:
            await pending.unrequested_end
        except asyncio.CancelledError:
            pending.end_requested.set()
            await pending.end_allowed
            raise
        finally:
            self.activities.remove(pending)


def _ending(decision: str, reason: Reason) -> PcmrsError:
    if decision == "unknown" and reason.code == UNKNOWN:
        return UnknownOutcomeError(reason.text, **reason.fields)
    return _refusal(reason)


def _refusal(reason: Reason) -> RefusalError:
    fields = {name: value for name, value in reason.fields.items() if name not in ("check", "step")}
    error = RefusalError(reason.code, reason.text)
    error.fields = fields
    return error


def _typed(data: PlacementData, plain: dict[str, Any]) -> dict[str, Any]:
    """Return the changes of the data, converted to its types."""
    kinds = {each.name: each.type for each in msgspec.structs.fields(type(data))}
    try:
        return {name: msgspec.convert(value, kinds[name]) for name, value in plain.items()}
    except (KeyError, msgspec.ValidationError) as error:
        raise RefusalError("data_unreadable", f"The recorded data are not those of this program: {error}.") from None


def _command_key(run: Run) -> CommandKey:
    return run.command.source, run.command.id
