"""A journal that fails is reopened, from whenever it failed, now and then, and only if it was the journal."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable
from contextlib import suppress
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import pytest
from structlog.testing import capture_logs

from pcmrs.dispatcher import DispatcherListener
from pcmrs.errors import JournalError
from pcmrs.journal import Journal
from pcmrs.messages import BlueprintTag, Reason
from pcmrs.service.restart.recorder import JournalRecorder
from pcmrs.service.restart.recovery import RETRY_AFTER, conclude, keep_journal
from pcmrs.testing.clock import ManualClock, settle
from pcmrs.workflows.opening import open_workflow

FAILED = Reason(code=JournalError.code, text="The journal cannot be written: disk full.")

MANY = 100
"""More attempts than a disk that is tried now and then sees in a test."""


class Cell:
    """A dispatcher, journal and recorder of which only the failure matters."""

    def __init__(self) -> None:
        self.clock = ManualClock()
        self.broken: Reason | None = None
        self.full = True
        self.reopened = 0
        self.procedure = SimpleNamespace(blueprint=None)
        self.fail: Callable[[], None] = lambda: None
        self._keeping: asyncio.Task[None] | None = None

    def keep(self) -> None:
        everything = cast(Any, self)
        self._keeping = asyncio.create_task(keep_journal(everything, everything, everything, self.clock))

    def add_listener(self, listener: DispatcherListener) -> None:
        self.fail = listener.on_failure

    async def reopen(self) -> int:
        self.reopened += 1
        if self.reopened > MANY:
            await asyncio.Event().wait()  # the manual clock would never come to the end of attempts without a pause
        if self.full:
            raise JournalError("Still full.")
        return 1

    def read_back(self, _blueprint: object) -> Any:
        return SimpleNamespace(begun=())

    async def resume(self, _begun: object) -> None:
        self.broken = None

    async def close(self) -> None:
        if self._keeping is not None:
            self._keeping.cancel()
            with suppress(asyncio.CancelledError):
                await self._keeping


@pytest.fixture
async def cell() -> AsyncIterator[Cell]:
    made = Cell()
    yield made
    await made.close()


@pytest.mark.parametrize("before", [True, False])
async def test_reopening_is_retried_at_intervals_until_it_succeeds(cell: Cell, before: bool) -> None:
    cell.broken = FAILED if before else None
    cell.keep()
    await settle()
    if not before:
        cell.broken = FAILED
        cell.fail()
        await settle()
    assert cell.reopened == 1
    await cell.clock.advance(0.5 * RETRY_AFTER)
    assert cell.reopened == 1
    await cell.clock.advance(3.0 * RETRY_AFTER)
    assert cell.reopened == 4
    cell.full = False
    await cell.clock.advance(RETRY_AFTER)
    assert (cell.reopened, cell.broken) == (5, None)
    await cell.clock.advance(10.0 * RETRY_AFTER)
    assert cell.reopened == 5


@pytest.mark.parametrize("code", ["internal_error", "ending"])
async def test_failure_outside_the_journal_is_left_to_a_restart(cell: Cell, code: str) -> None:
    cell.broken = Reason(code=code, text="Not the disk.")
    cell.keep()
    await settle()
    cell.fail()
    await cell.clock.advance(10.0 * RETRY_AFTER)
    assert cell.reopened == 0


async def test_an_end_without_a_last_row_is_an_end_too(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(_rows: object) -> None:
        raise JournalError("disk full")

    journal = Journal.open(tmp_path / "ratms.sqlite", durable=False)
    recorder = JournalRecorder(journal, ManualClock(), "s1", BlueprintTag(id="", version="", hash=""))
    recorder.read_back(open_workflow("ratms").blueprint)
    monkeypatch.setattr(journal, "append", full)
    with capture_logs() as logged:
        await conclude(recorder)
    await journal.close()
    assert [line["event"] for line in logged] == ["no_last_snapshot"]
