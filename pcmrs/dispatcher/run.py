"""What checks, steps and activities see of the procedure and its cell."""

from __future__ import annotations

import asyncio
import uuid
from collections.abc import Awaitable, Callable
from dataclasses import dataclass, field
from typing import Any, Generic, TypeVar

import msgspec

from pcmrs.clock import Clock
from pcmrs.errors import RefusalError
from pcmrs.fsm.blueprint import Motion
from pcmrs.messages import Command, Reason, Verdict


class ProcedureData(msgspec.Struct, frozen=True, kw_only=True):
    """What a procedure has gathered so far; workflows add their own fields. Immutable.

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
    """Handed to every check and step of one operation.

    Attributes:
        command: What was asked.
        payload: Its arguments as the registered type.
        states: The joint state it started in; its own branches cannot change under it.
        cell: The devices and frames of the cell.
        clock: The cell's clock.
        motion: Which way the operation moves the robot, as its blueprint declares it.
        latched: Stop was latched when the operation began.
        outcome: Declared outcome to end with; a last step of an operation with outcomes sets it.
        result: What the verdict reports.
        prepared: What a check has worked out for a step, such as a trajectory.
        undecided: What a check could not decide yet, in words, for whoever only asks.
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
    _plan_anew: Callable[[], Awaitable[Reason | None]] | None = None

    @property
    def data(self) -> D:
        """The procedure's data with the changes of this run."""
        return msgspec.structs.replace(self._data, **self.changes) if self.changes else self._data

    def use_planner(self, plan_anew: Callable[[], Awaitable[Reason | None]]) -> None:
        """Takes what asks the operation's checks once more."""
        self._plan_anew = plan_anew

    async def plan_anew(self) -> None:
        """Asks the operation's checks once more, by what is known now: a step calls it when the arm stands.

        Raises:
            RefusalError: One of them refuses.
        """
        refused = None if self._plan_anew is None else await self._plan_anew()
        if refused is not None:
            raise RefusalError(refused.code, refused.text, **refused.fields)

    def keep(self, **changes: Any) -> None:
        """Changes fields of the procedure's data; they are committed with the states, or not at all."""
        self.changes.update(changes)

    def post(self, branch: str, operation: str, **arguments: Any) -> None:
        """Submits a command once this operation is committed, without waiting for it."""
        self.posts.append((branch, operation, arguments))

    def progress(self, fraction: float) -> None:
        """Shows how far the operation is, from 0 to 1."""
        self._show_progress(fraction)


@dataclass(eq=False)
class Activity(Generic[C, D]):
    """Handed to the function of an activity, which goes on until it is cancelled.

    A function that moves the robot ends its motion before it lets the cancellation through. What returns or raises by
    itself takes the lane of Stop. It must not await the dispatcher; it may `post`.

    Attributes:
        name: Registered name of the function.
        branch: The branch whose state it belongs to.
        state: That state.
        command: The command that led into the state.
        cell: The devices and frames of the cell.
        clock: The cell's clock.
        values: What it shows of itself in the snapshot.
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
        """Who asks for what it posts, and where its events come from."""
        return f"activity:{self.name}"

    @property
    def data(self) -> D:
        """The procedure's data now."""
        return self._data()

    @property
    def states(self) -> dict[str, str]:
        """The joint state now."""
        return self._states()

    def post(self, branch: str, operation: str, **arguments: Any) -> asyncio.Future[Verdict]:
        """Submits a command at once; it may ask for events, too.

        Returns:
            The verdict to come: to look at, never to await.
        """
        return self._submit(self.command_to(branch, operation, arguments))

    def show(self, **values: Any) -> None:
        """Shows values in the snapshot, beside those shown before; each change is published: a few per second."""
        shown = self.values | values
        if shown != self.values:
            self.values = shown
            self._show()

    def command_to(self, branch: str, operation: str, arguments: dict[str, Any]) -> Command:
        """A command of this activity, of which the command that led into the state is the parent."""
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
