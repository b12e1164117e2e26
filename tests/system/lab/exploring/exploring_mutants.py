"""Guards taken out of the daemon, one at a time: each mutant must be found by exploring and shrunk."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from typing import Any

import pytest

from pcmrs.devices.node import DeviceNode
from pcmrs.devices.standstill import Standstill
from pcmrs.dispatcher._admission import CommandAdmission
from pcmrs.dispatcher.procedure import Procedure
from pcmrs.dispatcher.verdict_cache import VerdictCache
from pcmrs.service._command_metrics import CommandMetrics
from pcmrs_sim.deterministic.disk import SimulatedJournal

Mutation = Callable[[pytest.MonkeyPatch], None]


def latch_not_checked(patch: pytest.MonkeyPatch) -> None:
    """What moves may begin while Stop is latched."""
    barred = CommandAdmission._barred

    def unbarred(self: Any, attempt: Any) -> Any:
        reason = barred(self, attempt)
        return None if reason is not None and reason.code == "latched" else reason

    patch.setattr(CommandAdmission, "_barred", unbarred)


def stop_does_not_latch(patch: pytest.MonkeyPatch) -> None:
    """Stop ends what runs, and the next motion may begin at once, unacknowledged; it says that it is latched."""
    joint = Procedure.snapshot

    def latched(self: Any, *given: Any) -> Any:
        return joint(self, *given)

    def latch(self: Any) -> None:
        self.latched = False
        self.sequence = self.reserve()

    patch.setattr(Procedure, "snapshot", latched)
    patch.setattr(Procedure, "latch", latch)


def acknowledged_before_written(patch: pytest.MonkeyPatch) -> None:
    """The journal says that rows are durable before they are."""

    def append(self: Any, rows: Any) -> Awaitable[int]:
        asyncio.get_running_loop().call_later(0.01, _late, self, rows)
        done: asyncio.Future[int] = asyncio.get_running_loop().create_future()
        done.set_result(0)
        return done

    patch.setattr(SimulatedJournal, "append", append)


def _late(journal: Any, rows: Any) -> None:
    if not journal._gone:
        super(SimulatedJournal, journal).append(rows)


def repeats_are_performed(patch: pytest.MonkeyPatch) -> None:
    """A command with the id of an earlier one is taken for a new one."""

    def verdict_of(_self: Any, _command: Any) -> tuple[asyncio.Future[Any], bool]:
        return asyncio.get_running_loop().create_future(), True

    patch.setattr(VerdictCache, "verdict_of", verdict_of)


def unasked_motion_is_ignored(patch: pytest.MonkeyPatch) -> None:
    """Neither node nor daemon sees that the arm moves while nothing runs."""
    patch.setattr(Standstill, "take", lambda _self, _state: None)


def commands_have_no_time_of_arrival(patch: pytest.MonkeyPatch) -> None:
    """A motion that waited for a blocked loop begins, as if it had just arrived."""
    submit = CommandMetrics.submit

    async def submit_as_new(self: Any, command: Any, **_: Any) -> Any:
        return await submit(self, command)

    patch.setattr(CommandMetrics, "submit", submit_as_new)


def reports_of_devices_are_lost(patch: pytest.MonkeyPatch) -> None:
    """The node passes no event of its devices on, and holds nothing because of it."""

    async def read_only(_self: Any, _name: str, device: Any) -> None:
        async for _ in device.events():
            pass

    patch.setattr(DeviceNode, "_publish_events", read_only)


MUTANTS: dict[str, Mutation] = {
    each.__name__: each
    for each in (latch_not_checked, stop_does_not_latch, acknowledged_before_written, repeats_are_performed)
}
SCRIPTED: dict[str, Mutation] = {
    each.__name__: each
    for each in (unasked_motion_is_ignored, commands_have_no_time_of_arrival, reports_of_devices_are_lost)
}
"""Mutants that sessions which are drawn seldom meet: a script shows each."""
