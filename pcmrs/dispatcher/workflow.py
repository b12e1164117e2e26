"""A workflow ready to run: its blueprint, and the functions and types that it names."""

from __future__ import annotations

import inspect
from collections.abc import Awaitable, Callable, Container, Coroutine, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Generic, TypeVar

import msgspec

from pcmrs.dispatcher._run import Activity, C, D, Run
from pcmrs.errors import BlueprintError
from pcmrs.fsm import Blueprint, Effect
from pcmrs.fsm.finding import summary
from pcmrs.fsm.rules.declared import KnownHazards, check_declared

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
