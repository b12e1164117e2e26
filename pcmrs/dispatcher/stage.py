"""What operations and activities are performed with."""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Sequence
from contextvars import ContextVar
from dataclasses import dataclass
from typing import Generic

from pcmrs.clock import Clock
from pcmrs.dispatcher.hold import Hold
from pcmrs.dispatcher.procedure import Procedure
from pcmrs.dispatcher.run import C, D
from pcmrs.dispatcher.tasks import Tasks
from pcmrs.dispatcher.workflow import Workflow

performing: ContextVar[int | None] = ContextVar("performing", default=None)
"""Id of the procedure on behalf of which the present task runs checks, steps or an activity."""


@dataclass(frozen=True)
class Stage(Generic[C, D]):
    """The parts of one dispatcher that those who perform share.

    Attributes:
        workflow: The procedure as it was written.
        procedure: Where it stands.
        cell: The devices and frames that operations and activities use.
        clock: The cell's clock.
        hold: Holds the robot.
        tasks: What is under way.
        show: Publishes a snapshot.
        release: Releases what Stop has latched; see `Dispatcher`.
    """

    workflow: Workflow[C, D]
    procedure: Procedure[C, D]
    cell: C
    clock: Clock
    hold: Hold
    tasks: Tasks
    show: Callable[[], None]
    release: Callable[[bool], Awaitable[Sequence[str]]] | None
