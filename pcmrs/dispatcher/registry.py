"""Payload types, checks and steps under the names that blueprints use."""

from __future__ import annotations

import inspect
from collections.abc import Awaitable, Callable
from dataclasses import dataclass, field
from typing import Any, Generic, TypeVar

import msgspec

from pcmrs.dispatcher.run import C, D, Run
from pcmrs.errors import BlueprintError
from pcmrs.fsm import Blueprint

Check = Callable[[Run[C, D]], None]
Step = Callable[[Run[C, D]], Awaitable[None] | None]
F = TypeVar("F", bound=Callable[..., Any])


class NoArguments(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The payload of operations that take no arguments."""


@dataclass
class Registry(Generic[C, D]):
    """What the names in a blueprint stand for. Functions are registered under their own names."""

    payloads: dict[str, type[msgspec.Struct]] = field(default_factory=lambda: {"none": NoArguments})
    checks: dict[str, Check[C, D]] = field(default_factory=dict)
    steps: dict[str, Step[C, D]] = field(default_factory=dict)
    worldly: set[str] = field(default_factory=set)

    def payload(self, name: str, kind: type[msgspec.Struct]) -> None:
        """Registers the type of an operation's arguments."""
        self.payloads[name] = kind

    def check(self, function: F) -> F:
        """Registers a pure check: it raises `RefusalError` or returns."""
        self.checks[function.__name__] = function
        return function

    def step(self, function: F) -> F:
        """Registers a step that changes the procedure's data only, and so has nothing to wait for.

        Raises:
            BlueprintError: It is a coroutine function.
        """
        if inspect.iscoroutinefunction(function):
            text = f"{function.__name__} waits, so it touches the world: register it with world_step."
            raise BlueprintError(text, step=function.__name__)
        self.steps[function.__name__] = function
        return function

    def world_step(self, function: F) -> F:
        """Registers a step that touches the world outside: its intent is journalled first."""
        self.worldly.add(function.__name__)
        self.steps[function.__name__] = function
        return function

    def check_names(self, blueprint: Blueprint) -> None:
        """Raises `BlueprintError` if the blueprint uses a name that is not registered."""
        for branch_name, branch in blueprint.branches.items():
            for name, operation in branch.operations.items():
                wanted = (
                    ("payload", [operation.payload], self.payloads),
                    ("check", operation.checks, self.checks),
                    ("step", operation.steps, self.steps),
                )
                for kind, names, known in wanted:
                    for unknown in set(names) - set(known):
                        text = f"{branch_name}.{name}: no {kind} is registered as {unknown!r}"
                        raise BlueprintError(text, branch=branch_name, operation=name)
