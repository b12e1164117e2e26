"""The real RATMS blueprint on steps that do as the test says, and a journal in memory."""

from __future__ import annotations

import asyncio
import itertools
from collections.abc import Awaitable, Callable, Collection, Mapping, Sequence
from contextlib import suppress
from functools import cache
from typing import Any

import msgspec
import pytest

from pcmrs.dispatcher import Activity, Dispatcher, DispatcherListener, ProcedureData, Registry, Run, Workflow
from pcmrs.dispatcher.events import EarlierDecision
from pcmrs.dispatcher.execution import MotionChecker
from pcmrs.errors import JournalError, RefusalError, UnknownOutcomeError
from pcmrs.fsm import Blueprint, Effect
from pcmrs.messages import Command, DeviceEvent, Snapshot, Verdict
from pcmrs.testing.clock import ManualClock, settle
from tests.support.ratms_oracle import Joint, all_operations, expected
from tests.support.shipped import shipped_blueprint

RATMS = shipped_blueprint("ratms")


WORLDLY_BRANCHES = ("digitization", "robot", "placement")


Route = list[tuple[str, str, str]]
"""Branch, operation and ending, one after the other."""


class Numbers(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Arguments of every operation that takes any."""

    values: list[float] = []


class Notes(ProcedureData, frozen=True, kw_only=True):
    """Data that shows what was committed: one mark per operation, and the effects of the last commit."""

    marks: tuple[str, ...] = ()
    effects: tuple[str, ...] = ()


class Script:
    """What the steps and checks of each operation do: they succeed unless told otherwise.

    Attributes:
        steps: Operation to an action that its steps perform; it may set the outcome, raise or wait.
        checks: Operation to the error that its first check raises.
        entered: Operations whose steps have been entered, in order.
        activities: Activity to what it does.
        acting: All activities that have begun, in order.
        log: Beginnings and ends of activities, and steps, in order.
    """

    def __init__(self) -> None:
        self.steps: dict[str, Callable[[Run[Any, Notes]], Awaitable[None]]] = {}
        self.checks: dict[str, Exception] = {}
        self.entered: list[str] = []
        self.activities: dict[str, Callable[[Activity[Any, Notes]], Awaitable[None]]] = {}
        self.acting: list[Activity[Any, Notes]] = []
        self.log: list[str] = []

    def end(self, operation: str, ending: str) -> None:
        """Makes an operation end as declared, ``failed`` or ``unknown``."""

        async def act(run: Run[Any, Notes]) -> None:
            if ending == "failed":
                raise RefusalError("told_to_fail", "The test wants this step to fail.")
            if ending == "unknown":
                raise UnknownOutcomeError("The test wants nobody to know.")
            run.outcome = None if ending == "done" else ending

        self.steps[operation] = act

    def hang(self, operation: str) -> asyncio.Event:
        """Makes an operation wait in its step until the event is set."""
        gate = asyncio.Event()

        async def act(run: Run[Any, Notes]) -> None:
            await gate.wait()

        self.steps[operation] = act
        return gate

    async def go_on(self, act: Activity[Any, Notes]) -> None:
        """An activity does as told, or else nothing, until it is cancelled."""
        self.acting.append(act)
        self.log.append(f"{act.name} begins")
        try:
            await self.activities.get(act.name, _wait)(act)
        finally:
            self.log.append(f"{act.name} ends")

    def check(self, run: Run[Any, Notes]) -> None:
        error = self.checks.get(_name(run))
        if error is not None:
            raise error

    async def world_step(self, run: Run[Any, Notes]) -> None:
        self._note(run)
        if _name(run) in self.steps:
            await self.steps[_name(run)](run)

    def data_step(self, run: Run[Any, Notes]) -> None:
        """A step that touches nothing outside and so has nothing to wait for."""
        self._note(run)
        if _name(run) in self.steps:
            action = self.steps[_name(run)](run).__await__()
            with suppress(StopIteration):
                next(action)
                pytest.fail(f"{_name(run)} touches nothing outside: its step cannot wait")

    def _note(self, run: Run[Any, Notes]) -> None:
        name = _name(run)
        self.entered.append(name)
        self.log.append(name)
        run.outcome = _usual_outcome(run)
        if "marks" not in run.changes and name not in run.data.marks[-1:]:
            run.keep(marks=(*run.data.marks, name))


async def _wait(_act: Activity[Any, Notes]) -> None:
    await asyncio.Event().wait()


def _name(run: Run[Any, Notes]) -> str:
    return f"{run.command.branch}.{run.command.operation}"


def _usual_outcome(run: Run[Any, Notes]) -> str | None:
    ready = (run.states.get("registration"), run.states.get("toolplan")) == ("111", "1")
    return {
        "digitization.digitize_one": "complete",
        "digitization.reuse_previous_of": "complete",
        "digitization.check_landmark": "same",
        "toolplan.plan": "planned",
        "toolplan.use_previous": "planned",
        "placement.locate": "retracted",
        "placement.back_off": "standoff" if ready else "retracted",
    }.get(_name(run))


def _settle(data: Notes, states: Mapping[str, str], effects: Sequence[Effect]) -> Notes:
    return msgspec.structs.replace(data, effects=tuple(f"{e.kind} {e.branch} {e.target}" for e in effects))


def make_workflow(
    script: Script, blueprint: Blueprint = RATMS, worldly_branches: Collection[str] = WORLDLY_BRANCHES
) -> Workflow[Any, Notes]:
    """The blueprint with every name in it registered as the script's check or step."""
    registry: Registry[Any, Notes] = Registry()
    for branch_name, branch in blueprint.branches.items():
        registry.activities |= {a.run: script.go_on for a in branch.activities.values()}
        for spec in branch.operations.values():
            registry.checks |= dict.fromkeys(spec.checks, script.check)
            side_effecting = branch_name in worldly_branches
            registry.steps |= dict.fromkeys(spec.steps, script.world_step if side_effecting else script.data_step)
            if side_effecting:
                registry.side_effecting.update(spec.steps)
            if spec.payload != "none":
                registry.payload(spec.payload, Numbers)
    return Workflow(blueprint, registry, Notes(), _settle)


class MemoryRecorder:
    """A journal in memory; writes one thing after the other, and blocks or fails where it is told to.

    Attributes:
        rows: What has been written, in order: kind, id or code, states, and the verdict if any.
        failing: Kinds of calls that fail: intent, decision, event, recall.
        gates: Kind to an event without which the write does not go on.
    """

    def __init__(self) -> None:
        self.rows: list[tuple[str, str, dict[str, str], Verdict | None]] = []
        self.commands: list[Command] = []
        self.with_intent: dict[str, bool] = {}
        self.failing: set[str] = set()
        self.gates: dict[str, asyncio.Event] = {}
        self.earlier: dict[tuple[str, str], EarlierDecision] = {}
        self._turn = asyncio.Lock()

    async def intent(self, command: Command, states: Mapping[str, str]) -> None:
        await self._write("intent", command.id, states, None)

    async def decision(
        self,
        command: Command,
        verdict: Verdict,
        states: Mapping[str, str],
        changes: Mapping[str, Any],
        *,
        with_intent: bool,
    ) -> None:
        await self._write("decision", command.id, states, verdict)
        self.commands.append(command)
        self.with_intent[command.id] = with_intent

    async def event(self, event: DeviceEvent, states: Mapping[str, str]) -> None:
        await self._write("event", event.code, states, None)

    def recall(self, source: str, command_id: str) -> EarlierDecision | None:
        if "recall" in self.failing:
            raise JournalError("The disk is gone.")
        return self.earlier.get((source, command_id))

    def kinds(self, command_id: str) -> list[str]:
        """What was written about a command."""
        return [kind for kind, name, _, _ in self.rows if name == command_id]

    async def _write(self, kind: str, name: str, states: Mapping[str, str], verdict: Verdict | None) -> None:
        async with self._turn:
            if kind in self.gates:
                await self.gates[kind].wait()
            if kind in self.failing:
                raise JournalError("The disk is full.")
            self.rows.append((kind, name, dict(states), verdict))


class Bench(DispatcherListener):
    """A dispatcher with everything around it in the test's hands.

    Attributes:
        published: Snapshots, verdicts and events in order of publication.
        holds: How often the robot was held; `hold_error` is raised by each of them.
        hold: How the robot is held.

    Args:
        blueprint: Of the workflow.
        worldly_branches: Whose operations touch the world.
        planner: Is asked the checks in `lasting`.
        lasting: Names of checks that take long.
    """

    def __init__(
        self,
        blueprint: Blueprint = RATMS,
        worldly_branches: Collection[str] = WORLDLY_BRANCHES,
        planner: MotionChecker[Any, Notes] | None = None,
        lasting: Collection[str] = (),
    ) -> None:
        self.script = Script()
        self.clock = ManualClock()
        self.recorder = MemoryRecorder()
        self.published: list[Snapshot | Verdict | DeviceEvent] = []
        self.holds = 0
        self.hold_error: Exception | None = None
        self.hold: Callable[[], Awaitable[object]] = self._hold
        self._ids = itertools.count(1)
        workflow = make_workflow(self.script, blueprint, worldly_branches)
        workflow.registry.lasting.update(lasting)
        self.latching: list[bool] = []
        self.released: list[bool] = []
        self.releasing: asyncio.Event | None = None
        self.release_error: Exception | None = None
        self.still_latched: list[str] = []
        self.dispatcher = Dispatcher(
            workflow,
            None,
            self.clock,
            self.recorder,
            self._hold_devices,
            release=self._release_devices,
            planner=planner,
        )
        self.dispatcher.add_listener(self)

    def on_publish(self, message: Snapshot | Verdict | DeviceEvent) -> None:
        self.published.append(message)

    def _hold_devices(self, latch: bool) -> Awaitable[object]:
        self.latching.append(latch)
        return self.hold()

    async def _release_devices(self, stopped: bool) -> list[str]:
        self.released.append(stopped)
        if self.releasing is not None:
            await self.releasing.wait()
        if self.release_error is not None:
            raise self.release_error
        return self.still_latched

    async def _hold(self) -> None:
        self.holds += 1
        if self.hold_error is not None:
            raise self.hold_error

    @property
    def joint(self) -> Joint:
        return tuple(self.dispatcher.snapshot().branches.values())  # type: ignore[return-value]

    @property
    def data(self) -> Notes:
        return self.dispatcher.procedure.data

    def command(self, name: str, source: str = "test:user", **fields: Any) -> Command:
        branch, operation = name.split(".")
        fields.setdefault("id", f"c{next(self._ids)}")
        if name == "robot.acknowledge":
            fields.setdefault("arguments", {"stop": self.dispatcher.stop_number})  # as who has seen the newest Stop
        return Command(branch=branch, operation=operation, source=source, **fields)

    async def do(self, name: str, **fields: Any) -> Verdict:
        """Submits a command, and waits until its verdict is published, which comes after the answer."""
        verdict = await self.dispatcher.submit(self.command(name, **fields))
        await asyncio.sleep(0)
        return verdict

    async def begin(self, name: str, **fields: Any) -> asyncio.Task[Verdict]:
        """Submits a command and lets it go as far as it can without its verdict."""
        task = asyncio.create_task(self.dispatcher.submit(self.command(name, **fields)))
        await settle()
        return task

    async def go(self, joint: Joint) -> None:
        """Takes the shortest way from the present joint state to another, by commands."""
        for branch, operation, ending in routes_from(self.joint)[joint]:
            await self.take(branch, operation, ending)
        assert self.joint == joint

    async def take(self, branch: str, operation: str, ending: str) -> Verdict:
        """Performs an operation so that it ends as told; the script is as before afterwards."""
        name = f"{branch}.{operation}"
        before = self.script.steps.pop(name, None)
        self.script.end(name, ending)
        event = RATMS.branches[branch].operations[operation].event
        verdict = await self.do(name, source="device:test" if event else "test:user")
        del self.script.steps[name]
        if before is not None:
            self.script.steps[name] = before
        return verdict

    def verdicts(self) -> list[Verdict]:
        return [message for message in self.published if isinstance(message, Verdict)]

    def snapshots(self) -> list[Snapshot]:
        return [message for message in self.published if isinstance(message, Snapshot)]


def has_steps(branch: str, operation: str) -> bool:
    """Whether its ending can be chosen by a step."""
    return bool(RATMS.branches[branch].operations[operation].steps)


@cache
def routes_from(start: Joint) -> dict[Joint, Route]:
    """Return the shortest way to each joint state that can be reached from `start`, as the oracle says."""
    found: dict[Joint, Route] = {start: []}
    waiting = [start]
    while waiting:
        joint = waiting.pop(0)
        for branch, operation in all_operations():
            for ending, after in (expected(joint, branch, operation) or {}).items():
                if after not in found:
                    found[after] = [*found[joint], (branch, operation, ending)]
                    waiting.append(after)
    return found


PLACED: Joint = ("111", "1", "1", "1", "placed", "0", "off")


STANDOFF: Joint = ("111", "1", "1", "1", "standoff", "0", "off")


RETRACTED: Joint = ("111", "1", "1", "1", "retracted", "0", "off")


HELD: Joint = ("111", "1", "1", "1", "held", "0", "off")


def code(verdict: Verdict) -> str:
    assert verdict.reason is not None
    return verdict.reason.code
