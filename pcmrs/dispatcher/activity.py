"""What goes on while a branch is in a state, as its function sees it."""

from __future__ import annotations

import asyncio
import uuid
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Generic

from pcmrs.clock import Clock
from pcmrs.dispatcher.run import C, D
from pcmrs.messages import Command, Verdict


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
