"""A workflow ready to run: its blueprint, the functions and types that it names, and the arguments of these."""

from __future__ import annotations

import asyncio
import inspect
import uuid
from collections.abc import Awaitable, Callable, Container, Coroutine, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Generic, TypeVar

import msgspec

from pcmrs.clock import Clock
from pcmrs.errors import BlueprintError, PcmrsError, RefusalError
from pcmrs.fsm import Blueprint, Effect
from pcmrs.fsm.blueprint import Motion
from pcmrs.fsm.finding import summary
from pcmrs.fsm.rules.declared import KnownHazards, check_declared
from pcmrs.messages import Command, Reason, TouchPrompt, Verdict


class ProcedureData(msgspec.Struct, frozen=True, kw_only=True):
    """Data of a procedure; workflows add their own fields. Immutable.

    Attributes:
        plan_id: Id of the accepted tool plan.
        registration_id: Id of the accepted registration.
    """

    plan_id: str | None = None
    registration_id: str | None = None


C = TypeVar("C")
D = TypeVar("D", bound=ProcedureData)


@dataclass
class Run(Generic[C, D]):
    """Argument of every check and step of one operation.

    Attributes:
        command: The command.
        payload: Its arguments as the registered type.
        states: The joint state in which it started; its own branches cannot change while it runs.
        cell: The devices and frames of the cell.
        clock: The cell's clock.
        motion: Kind of motion that the blueprint declares for the operation.
        latched: Stop was latched when the operation started.
        outcome: Declared outcome to end with; the last step of an operation with outcomes sets it.
        result: Results that the verdict reports.
        prepared: Result of a check for a step, such as a trajectory.
        undecided: Texts for a dry run about what a check could not decide yet.
    """

    command: Command
    payload: Any
    states: dict[str, str]
    cell: C
    clock: Clock
    _data: D
    _show_progress: Callable[[float], None]
    motion: Motion = "none"
    latched: bool = False
    outcome: str | None = None
    result: dict[str, Any] = field(default_factory=dict)
    prepared: Any = None
    undecided: list[str] = field(default_factory=list)
    changes: dict[str, Any] = field(default_factory=dict)
    posts: list[tuple[str, str, dict[str, Any]]] = field(default_factory=list)
    _replan: Callable[[], Awaitable[Reason | None]] | None = None
    _plan: Callable[[str, float], Awaitable[Reason | None]] | None = None
    _show_prompt: Callable[[TouchPrompt | None], None] | None = None

    @property
    def data(self) -> D:
        """Data of the procedure with the changes of this run."""
        return msgspec.structs.replace(self._data, **self.changes) if self.changes else self._data

    def use_planner(
        self,
        replan: Callable[[], Awaitable[Reason | None]],
        plan: Callable[[str, float], Awaitable[Reason | None]],
    ) -> None:
        """Set the functions that ask checks while the steps run.

        Args:
            replan: Asks the operation's checks again.
            plan: Asks one check by its registered name, and waits for its answer so long, s of the machine.
        """
        self._replan, self._plan = replan, plan

    async def replan(self) -> None:
        """Ask the operation's checks again, with the present data: a step calls it when the arm stands.

        Raises:
            RefusalError: A check refuses.
        """
        _heed(None if self._replan is None else await self._replan())

    async def plan(self, check: Callable[[Any], None], *, within: float) -> None:
        """Ask a check during the steps, as those of the operation are asked before them: it plans the next motion.

        The check finds its question in `prepared`, and leaves the plan there.

        Args:
            check: A check that is registered with `Registry.long_check`; the blueprint need not name it.
            within: Limit of the wait for a planner, s of the machine.

        Raises:
            RefusalError: The check refuses, the planner has no answer in time, or latch, lease, states, plan,
                registration or the measured joints have changed until it came. The motion must not begin.
            PcmrsError: The run is not performed by a dispatcher.
        """
        if self._plan is None:
            raise PcmrsError(f"{check.__name__} can only be asked while a dispatcher performs the operation.")
        _heed(await self._plan(check.__name__, within))

    def keep(self, **changes: Any) -> None:
        """Change fields of the procedure's data; they are committed with the states, or not at all."""
        self.changes.update(changes)

    def post(self, branch: str, operation: str, **arguments: Any) -> None:
        """Submit a command once this operation is committed, without waiting for it.

        Args:
            branch: Branch of the command.
            operation: Its operation.
            arguments: Its arguments.
        """
        self.posts.append((branch, operation, arguments))

    def progress(self, fraction: float) -> None:
        """Publish the progress of the operation, from 0 to 1."""
        self._show_progress(fraction)

    def prompt(self, prompt: TouchPrompt | None) -> None:
        """Publish what the operation waits for a person to touch; None when it waits no more."""
        if self._show_prompt is not None:
            self._show_prompt(prompt)


def _heed(refused: Reason | None) -> None:
    if refused is not None:
        raise RefusalError(refused.code, refused.text, **refused.fields)


@dataclass(eq=False)
class Activity(Generic[C, D]):
    """Argument of the function of an activity, which runs until it is cancelled.

    A function that moves the robot ends its motion before it lets the cancellation through. If it returns or raises by
    itself, everything is stopped. It must not await the dispatcher; it may `post`.

    Attributes:
        name: Registered name of the function.
        branch: Branch of the state that it belongs to.
        state: The state.
        command: The command that led into the state.
        cell: The devices and frames of the cell.
        clock: The cell's clock.
        values: Values that the snapshot shows.
    """

    name: str
    branch: str
    state: str
    command: Command
    cell: C
    clock: Clock
    _data: Callable[[], D]
    _states: Callable[[], dict[str, str]]
    _submit: Callable[[Command], asyncio.Future[Verdict]]
    _show: Callable[[], None]
    values: dict[str, Any] = field(default_factory=dict)

    @property
    def source(self) -> str:
        """Source of its commands and events."""
        return f"activity:{self.name}"

    @property
    def data(self) -> D:
        """Present data of the procedure."""
        return self._data()

    @property
    def states(self) -> dict[str, str]:
        """Present joint state."""
        return self._states()

    def post(self, branch: str, operation: str, **arguments: Any) -> asyncio.Future[Verdict]:
        """Submit a command at once; it may call event operations, too.

        Args:
            branch: Branch of the command.
            operation: Its operation.
            arguments: Its arguments.

        Returns:
            The verdict to come. Look at it, but never await it.
        """
        return self._submit(self.command_to(branch, operation, arguments))

    def show(self, **values: Any) -> None:
        """Show values in the snapshot, besides earlier ones; each change is published: a few per second."""
        shown = self.values | values
        if shown != self.values:
            self.values = shown
            self._show()

    def command_to(self, branch: str, operation: str, arguments: dict[str, Any]) -> Command:
        """Return a command of this activity, whose parent is the command that led into the state.

        Args:
            branch: Branch of the command.
            operation: Its operation.
            arguments: Its arguments.
        """
        return Command(
            id=f"{self.name}-{uuid.uuid4().hex}",
            branch=branch,
            operation=operation,
            source=self.source,
            user=self.command.user,
            role="daemon",
            arguments=arguments,
            parent=self.command.id,
        )


Check = Callable[[Run[C, D]], None]
Step = Callable[[Run[C, D]], Awaitable[None] | None]
ActivityFunction = Callable[[Activity[C, D]], Coroutine[Any, Any, None]]
F = TypeVar("F", bound=Callable[..., Any])


class NoArguments(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Payload of operations without arguments."""


@dataclass
class Registry(Generic[C, D]):
    """Functions and types that a blueprint names. Functions are registered under their own names."""

    payloads: dict[str, type[msgspec.Struct]] = field(default_factory=lambda: {"none": NoArguments})
    checks: dict[str, Check[C, D]] = field(default_factory=dict)
    steps: dict[str, Step[C, D]] = field(default_factory=dict)
    side_effecting: set[str] = field(default_factory=set)
    lasting: set[str] = field(default_factory=set)
    activities: dict[str, ActivityFunction[C, D]] = field(default_factory=dict)
    moving: set[str] = field(default_factory=set)
    affecting: set[str] = field(default_factory=set)

    def payload(self, name: str, kind: type[msgspec.Struct]) -> None:
        """Register the type of an operation's arguments.

        Args:
            name: Name in the blueprint.
            kind: The type.
        """
        self.payloads[name] = kind

    def check(self, function: F) -> F:
        """Register a pure check: it raises `RefusalError` or returns."""
        self.checks[function.__name__] = function
        return function

    def long_check(self, function: F) -> F:
        """Register a check that takes long, as planning a motion does: a planner asks it, if there is one.

        It reads command, states, data and cell of its run, and stores its results in `prepared`, `result` and
        `undecided`; all of that is sent between processes.
        """
        self.lasting.add(function.__name__)
        return self.check(function)

    def step(self, function: F) -> F:
        """Register a step that only changes the procedure's data, and so has nothing to wait for.

        Raises:
            BlueprintError: It is a coroutine function.
        """
        if inspect.iscoroutinefunction(function):
            text = f"{function.__name__} waits, so it touches the world: register it with world_step."
            raise BlueprintError(text, step=function.__name__)
        self.steps[function.__name__] = function
        return function

    def world_step(self, function: F, *, moves: bool = False, affects_patient: bool = False) -> F:
        """Register a step that acts on the world: its intent is journalled first.

        Args:
            function: The step.
            moves: It moves the robot: an operation with it must declare `motion`.
            affects_patient: It acts on the patient otherwise: an operation with it must declare `affects_patient`.
        """
        self.side_effecting.add(function.__name__)
        if moves:
            self.moving.add(function.__name__)
        if affects_patient:
            self.affecting.add(function.__name__)
        self.steps[function.__name__] = function
        return function

    def activity(self, function: F, *, moves: bool = False) -> F:
        """Register an activity, which runs while a branch is in a state and is cancelled when the state is left.

        Args:
            function: The activity.
            moves: It moves the robot, which a blueprint with it must declare.

        Raises:
            BlueprintError: It is not a coroutine function.
        """
        if not inspect.iscoroutinefunction(function):
            text = f"{function.__name__} does not wait, so it would end at once: write it with async def."
            raise BlueprintError(text, activity=function.__name__)
        self.activities[function.__name__] = function
        if moves:
            self.moving.add(function.__name__)
        return function

    @property
    def known(self) -> KnownHazards:
        """Properties of the functions, for the verifier."""
        return KnownHazards(moving=frozenset(self.moving), affecting=frozenset(self.affecting))

    def check_declarations(self, blueprint: Blueprint) -> None:
        """Raise `BlueprintError` if the blueprint does not declare what its steps and activities do."""
        findings = list(check_declared(blueprint, self.known))
        if findings:
            raise BlueprintError(summary(findings), findings=findings)

    def check_names(self, blueprint: Blueprint) -> None:
        """Raise `BlueprintError` if the blueprint uses a name that is not registered."""
        for branch, spec in blueprint.branches.items():
            for name, operation in spec.operations.items():
                self._check(f"{branch}.{name}", "payload", [operation.payload], self.payloads)
                self._check(f"{branch}.{name}", "check", operation.checks, self.checks)
                self._check(f"{branch}.{name}", "step", operation.steps, self.steps)
            for state, activity in spec.activities.items():
                self._check(f"{branch} {state}", "activity", [activity.run], self.activities)

    @staticmethod
    def _check(where: str, kind: str, names: Iterable[str], known: Container[str]) -> None:
        for name in names:
            if name not in known:
                raise BlueprintError(f"{where}: no {kind} is registered as {name!r}", where=where, name=name)


Settle = Callable[[D, Mapping[str, str], Sequence[Effect]], D]
"""Pure function that fits the data to a commit: (data, joint state after it, its effects) → data."""


@dataclass(frozen=True)
class Workflow(Generic[C, D]):
    """A procedure as the dispatcher runs it.

    Attributes:
        blueprint: Branches, states and operations.
        registry: Functions and types that the blueprint names.
        initial: Initial data.
        settle: Fits the data to a commit.

    Raises:
        BlueprintError: The blueprint uses a name that the registry does not know, or does not declare that a step moves
            the robot or affects the patient.
    """

    blueprint: Blueprint
    registry: Registry[C, D]
    initial: D
    settle: Settle[D]

    def __post_init__(self) -> None:
        self.registry.check_names(self.blueprint)
        self.registry.check_declarations(self.blueprint)
