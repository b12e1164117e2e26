"""Dispatcher on scripted checks and steps: nothing moves, and only the script lets time pass."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Mapping
from contextlib import asynccontextmanager
from functools import partial
from typing import Any

from msgspec.structs import replace

from pcmrs.authoring.trial.coverage import Deviation, deviation
from pcmrs.authoring.trial.tour import Tour, TourCommand
from pcmrs.dispatcher import Dispatcher, NoArguments, ProcedureData, Registry, Run, Workflow
from pcmrs.errors import DeviceError, RefusalError, UnknownOutcomeError
from pcmrs.fsm.behaviour import Joint, joint_of
from pcmrs.fsm.blueprint import START_OUTCOME, Blueprint
from pcmrs.messages import Command, DeviceEvent, Verdict

__all__ = ["LeapingClock", "ScriptedSteps", "rehearse", "scripted", "scripted_dispatcher"]

AHEAD = 3600.0
"""Offset of the arrival of commands into the future, s of the event loop: no command is too late on a busy machine."""


class LeapingClock:
    """Clock that stands still, and leaps to the end of every wait; deadlines before that expire.

    Its wall clock never changes.
    """

    def __init__(self) -> None:
        self._now = 0.0
        self._deadlines: list[tuple[float, asyncio.Timeout]] = []

    def monotonic(self) -> float:
        return self._now

    def wall(self) -> float:
        return 0.0  # the leaps are too long for the time stamps of journal rows

    async def sleep(self, seconds: float) -> None:
        self._now += seconds
        passed = [deadline for due, deadline in self._deadlines if due <= self._now]
        for deadline in passed:
            deadline.reschedule(0)
        await (asyncio.get_running_loop().create_future() if passed else asyncio.sleep(0))

    @asynccontextmanager
    async def timeout(self, seconds: float) -> AsyncIterator[None]:
        async with asyncio.timeout(None) as deadline:
            entry = (self._now + seconds, deadline)
            self._deadlines.append(entry)
            try:
                yield
            finally:
                self._deadlines.remove(entry)


class ScriptedSteps:
    """Behaviour of checks and steps for the present move of a tour.

    Attributes:
        move: Present move.
    """

    move: TourCommand

    def check(self, name: str, _run: Run[None, ProcedureData]) -> None:
        """Accept, unless the move requires this check to refuse.

        Args:
            name: Name of the check.
        """
        if self.move.decision == "rejected" and self.move.at == name:
            raise RefusalError("told_to", f"The tour wants {name} to refuse.")

    def step(self, name: str, run: Run[None, ProcedureData]) -> None:
        """End at once with the outcome that the move requires.

        Args:
            name: Name of the step.
            run: Run of the operation.
        """
        if self.move.at != name:
            run.outcome = None if self.move.ending == START_OUTCOME else self.move.ending
        elif self.move.how == "refuses":
            raise DeviceError(f"The tour wants {name} to refuse.")
        elif self.move.how == "silent":
            raise UnknownOutcomeError(f"The tour wants the outcome of {name} to be unknown.")
        else:
            raise RuntimeError(f"The tour wants {name} to raise.")

    async def side_effecting_step(self, name: str, run: Run[None, ProcedureData]) -> None:
        """End like `step`, or exceed the deadline if the move requires that.

        Args:
            name: Name of the step.
            run: Run of the operation.
        """
        if (self.move.at, self.move.how) == (name, "late"):
            await run.clock.sleep(float("inf"))
        self.step(name, run)


class NullRecorder:
    """Recorder that stores nothing."""

    async def intent(self, command: Command, states: Mapping[str, str]) -> None:
        """Store nothing."""

    async def decision(
        self,
        command: Command,
        verdict: Verdict,
        states: Mapping[str, str],
        changes: Mapping[str, Any],
        *,
        with_intent: bool,
    ) -> None:
        """Store nothing."""

    async def event(self, event: DeviceEvent, states: Mapping[str, str]) -> None:
        """Store nothing."""

    def recall(self, source: str, command_id: str) -> None:
        """Return None, since nothing is stored."""


def scripted(blueprint: Blueprint, script: ScriptedSteps, *, outside: bool) -> Workflow[None, ProcedureData]:
    """Return the workflow with scripted checks and steps, and without activities and timers.

    Args:
        blueprint: Workflow.
        script: Behaviour of checks and steps.
        outside: True if the steps have side effects, so that they are tasks with deadlines.
    """
    still = {name: replace(branch, activities={}, timers={}) for name, branch in blueprint.branches.items()}
    blueprint = replace(blueprint, branches=still)
    registry: Registry[None, ProcedureData] = Registry()
    specs = [spec for branch in blueprint.branches.values() for spec in branch.operations.values()]
    for spec in specs:
        registry.payload(spec.payload, NoArguments)
        registry.checks |= {name: partial(script.check, name) for name in spec.checks}
        registry.steps |= {
            name: partial(script.side_effecting_step if outside else script.step, name) for name in spec.steps
        }
        registry.side_effecting.update(spec.steps if outside else ())
    return Workflow(blueprint, registry, ProcedureData(), lambda data, _states, _effects: data)


def scripted_dispatcher(
    blueprint: Blueprint, script: ScriptedSteps, *, outside: bool
) -> Dispatcher[None, ProcedureData]:
    """Return a dispatcher of a scripted workflow, which stores nothing; see `scripted`.

    Args:
        blueprint: Workflow.
        script: Behaviour of checks and steps.
        outside: True if the steps have side effects.
    """
    workflow = scripted(blueprint, script, outside=outside)
    return Dispatcher(workflow, None, LeapingClock(), NullRecorder(), _hold)


async def rehearse(
    blueprint: Blueprint, tour: Tour, *, outside: bool
) -> AsyncIterator[tuple[TourCommand, Deviation | None]]:
    """Take the dispatcher through a tour.

    Args:
        blueprint: Workflow.
        tour: Tour of the workflow.
        outside: As for `scripted`; if false, no step can be late, and such a move raises instead.

    Yields:
        Every move, and its deviation if there is one; the rest of a stretch that has left the tour is skipped.
    """
    for stretch in tour.stretches:
        script = ScriptedSteps()
        dispatcher = scripted_dispatcher(blueprint, script, outside=outside)
        for number, move in enumerate(stretch):
            script.move = move
            arrived = asyncio.get_running_loop().time() + AHEAD
            verdict = await dispatcher.submit(_command(number, move), arrived=arrived)
            after = joint_of(blueprint, dispatcher.snapshot().branches)
            yield move, _judged(blueprint, move, verdict, after)
            if after != move.after:
                break


def _command(number: int, move: TourCommand) -> Command:
    source = "device:tour" if move.asker == "device" else "tour:user"
    return Command(id=str(number), branch=move.branch, operation=move.operation, source=source)


def _judged(blueprint: Blueprint, move: TourCommand, verdict: Verdict, after: Joint) -> Deviation | None:
    """Compare decision, code and states, and the check or step that the verdict names."""
    fields, code = (verdict.reason.fields, verdict.reason.code) if verdict.reason is not None else ({}, "")
    at = fields.get("step") or fields.get("check") or ""
    decision = verdict.decision if at == move.at else f"{verdict.decision} at {at or 'once'}"
    return deviation(blueprint, move, decision, after, code)


async def _hold(_latch: bool) -> None:
    """Do nothing: there is no robot to hold."""
