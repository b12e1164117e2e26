"""A workflow whose operations do what the journal says that came of them, where they would need the world to know."""

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
from pcmrs.replay.recorder import ReplayRecorder
from pcmrs.replay.world import NotJournalledError, ReplayClock
from pcmrs.workflows.cell import Cell
from pcmrs.workflows.data import PlacementData

Run = AnyRun[Cell, PlacementData]
Activity = AnyActivity[Cell, PlacementData]
Asked = tuple[str, str]
"""Source and id of a command."""

UNKNOWN = UnknownOutcomeError.code


@dataclass(frozen=True, eq=False)
class Steps:
    """The steps of an operation that touches the world: they wait until the journal says how they ended.

    Attributes:
        index: Of the outcome on record; None where it never came.
        row: That outcome.
        end: Set to let them end that way.
    """

    run: Run
    index: int | None
    row: JournalRow | None
    end: asyncio.Event


@dataclass(frozen=True, eq=False)
class Pursued:
    """An activity that goes on: it ends by itself, or once it was told to, when the journal says so.

    Attributes:
        by_itself: Done when it is to end by itself.
        told: Set when it has been told to end.
        quiet: Done when it is to heed that.
    """

    name: str
    by_itself: asyncio.Future[None]
    told: asyncio.Event
    quiet: asyncio.Future[None]


class ReplayWorkflow:
    """Checks and steps of data are performed for real; what looks at the world is answered by the journal.

    Args:
        workflow: The real one.
        recorder: What is on record.
        ask: `Procedure.ask` of the dispatcher that decides anew.

    Attributes:
        workflow: The same, with other checks, steps and activities under its names.
        waiting: Operations whose steps wait.
        pursued: Activities that go on.
        answered: Commands for which the journal was asked what came of the world.
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
        registry.activities = dict.fromkeys(real.activities, self._go_on)
        self.workflow = replace(workflow, registry=registry)
        self.waiting: list[Steps] = []
        self.pursued: list[Pursued] = []
        self.answered: set[Asked] = set()
        self._worldly = real.side_effecting
        self._taken: set[Asked] = set()
        self._recorder = recorder
        self._ask = ask

    # -- checks and steps -----------------------------------------------------------------------------

    def _check(self, name: str, check: Callable[[Run], None], run: Run) -> None:
        run.clock = ReplayClock()
        try:
            check(run)
        except NotJournalledError:
            self.answered.add(_asked(run))
            self._refuse_as_journalled(name, run)
        except PcmrsError:
            raise
        except Exception:
            if _asked(run) not in self.answered:
                raise
            self._refuse_as_journalled(name, run)  # it misses what a check before it has not worked out

    def _refuse_as_journalled(self, name: str, run: Run) -> None:
        _, row = self._journalled(run)
        reason = row.verdict.reason if row is not None and row.verdict is not None else None
        if reason is not None and reason.fields.get("check") == name:
            raise _refusal(reason)

    def _step(self, step: Callable[[Run], Awaitable[None] | None], run: Run) -> Awaitable[None] | None:
        run.clock = ReplayClock()
        spec = self.workflow.blueprint.branches[run.command.branch].operations[run.command.operation]
        if not self._worldly.isdisjoint(spec.steps):
            return self._wait(run)
        if _asked(run) not in self.answered:
            try:
                return step(run)
            except NotJournalledError:
                self.answered.add(_asked(run))
        self._end_as_journalled(run, self._journalled(run)[1])
        return None

    async def _wait(self, run: Run) -> None:
        """All steps of an operation end together, by what is on record of them."""
        if _asked(run) in self._taken:
            return
        self.answered.add(_asked(run))
        index, row = self._journalled(run)
        steps = Steps(run, index, row, asyncio.Event())
        self.waiting.append(steps)
        try:
            await steps.end.wait()
        finally:
            self.waiting.remove(steps)
        self._end_as_journalled(run, row)
        self._taken.add(_asked(run))

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
        """The declared outcome that leads to the states on record."""
        closure, after = self._ask(run.command.branch, run.command.operation), row.states or {}
        if isinstance(closure, Denial):
            return None
        fitting = (name for name, change in closure.outcomes.items() if change.targets.items() <= after.items())
        return next(fitting, None)

    def _journalled(self, run: Run) -> tuple[int | None, JournalRow | None]:
        found = self._recorder.outcome_of(run.command)
        return (None, None) if found is None else (found[0], found[1].row)

    # -- activities -----------------------------------------------------------------------------------

    async def _go_on(self, act: Activity) -> None:
        loop = asyncio.get_running_loop()
        pursued = Pursued(act.name, loop.create_future(), asyncio.Event(), loop.create_future())
        self.pursued.append(pursued)
        try:
            await pursued.by_itself
        except asyncio.CancelledError:
            pursued.told.set()
            await pursued.quiet
            raise
        finally:
            self.pursued.remove(pursued)


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
    """Changes of the data as its own types."""
    kinds = {each.name: each.type for each in msgspec.structs.fields(type(data))}
    try:
        return {name: msgspec.convert(value, kinds[name]) for name, value in plain.items()}
    except (KeyError, msgspec.ValidationError) as error:
        raise RefusalError("data_unreadable", f"The recorded data are not those of this program: {error}.") from None


def _asked(run: Run) -> Asked:
    return run.command.source, run.command.id
