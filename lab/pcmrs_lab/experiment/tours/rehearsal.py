"""The dispatcher on scripted checks and steps: nothing is moved and no time passes but what the script wants."""

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

AHEAD = 3600.0
"""Commands arrive so much in the future, s of the event loop: in a rehearsal none comes too late, however busy the
machine is."""


class LeapingClock:
    """A clock that stands still, and leaps to the end of every wait; a deadline on the way passes.

    Its wall clock stands still for good.
    """

    def __init__(self) -> None:
        self._now = 0.0
        self._deadlines: list[tuple[float, asyncio.Timeout]] = []

    def monotonic(self) -> float:
        return self._now

    def wall(self) -> float:
        return 0.0  # where the leaps lead, no journal's row can be written

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
    """What the checks and steps do: what the present move of a tour wants.

    Attributes:
        move: The present move.
    """

    move: TourCommand

    def check(self, name: str, _run: Run[None, ProcedureData]) -> None:
        """A check that agrees unless it is the one to refuse."""
        if self.move.decision == "rejected" and self.move.at == name:
            raise RefusalError("told_to", f"The tour wants {name} to refuse.")

    def step(self, name: str, run: Run[None, ProcedureData]) -> None:
        """A step that ends at once, as the move wants."""
        if self.move.at != name:
            run.outcome = None if self.move.ending == START_OUTCOME else self.move.ending
        elif self.move.how == "refuses":
            raise DeviceError(f"The tour wants {name} to refuse.")
        elif self.move.how == "silent":
            raise UnknownOutcomeError(f"The tour wants nobody to know how {name} has ended.")
        else:
            raise RuntimeError(f"The tour wants {name} to raise.")

    async def world_step(self, name: str, run: Run[None, ProcedureData]) -> None:
        """The same outside, where it may also take too long."""
        if (self.move.at, self.move.how) == (name, "late"):
            await run.clock.sleep(float("inf"))
        self.step(name, run)


class Forgetful:
    """A recorder that keeps nothing."""

    async def intent(self, command: Command, states: Mapping[str, str]) -> None:
        """Nothing is kept."""

    async def decision(
        self,
        command: Command,
        verdict: Verdict,
        states: Mapping[str, str],
        changes: Mapping[str, Any],
        *,
        with_intent: bool,
    ) -> None:
        """Nothing is kept."""

    async def event(self, event: DeviceEvent, states: Mapping[str, str]) -> None:
        """Nothing is kept."""

    def recall(self, source: str, command_id: str) -> None:
        """Nothing has been kept."""


def scripted(blueprint: Blueprint, script: ScriptedSteps, *, outside: bool) -> Workflow[None, ProcedureData]:
    """The workflow with every check and step in the script's hands, and nothing that goes on by itself.

    Args:
        blueprint: The workflow.
        script: Says what they do.
        outside: The steps touch the world outside, so that they are tasks with deadlines.
    """
    still = {name: replace(branch, activities={}) for name, branch in blueprint.branches.items()}
    blueprint = replace(blueprint, branches=still)
    registry: Registry[None, ProcedureData] = Registry()
    specs = [spec for branch in blueprint.branches.values() for spec in branch.operations.values()]
    for spec in specs:
        registry.payload(spec.payload, NoArguments)
        registry.checks |= {name: partial(script.check, name) for name in spec.checks}
        registry.steps |= {name: partial(script.world_step if outside else script.step, name) for name in spec.steps}
        registry.side_effecting.update(spec.steps if outside else ())
    return Workflow(blueprint, registry, ProcedureData(), lambda data, _states, _effects: data)


def scripted_dispatcher(
    blueprint: Blueprint, script: ScriptedSteps, *, outside: bool
) -> Dispatcher[None, ProcedureData]:
    """A dispatcher of such a workflow, which keeps nothing; see `scripted`."""
    workflow = scripted(blueprint, script, outside=outside)
    return Dispatcher(workflow, None, LeapingClock(), Forgetful(), _hold)


async def rehearse(
    blueprint: Blueprint, tour: Tour, *, outside: bool
) -> AsyncIterator[tuple[TourCommand, Deviation | None]]:
    """Takes the dispatcher through a tour.

    Args:
        blueprint: The workflow.
        tour: Its tour.
        outside: As for `scripted`; where it is not, nothing can be late, and what should be raises.

    Yields:
        Every command, and what was not as it must be; a stretch that has left the tour is not gone on with.
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
    """Compares decision, code and states, and which check or step the verdict names."""
    fields, code = (verdict.reason.fields, verdict.reason.code) if verdict.reason is not None else ({}, "")
    at = fields.get("step") or fields.get("check") or ""
    decision = verdict.decision if at == move.at else f"{verdict.decision} at {at or 'once'}"
    return deviation(blueprint, move, decision, after, code)


async def _hold(_latch: bool) -> None:
    """There is nothing to hold."""
