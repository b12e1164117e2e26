"""A journal is played row by row: each row is caused by what came from outside, and the dispatcher decides the rest."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable

import msgspec

from pcmrs.journal import StoredRow
from pcmrs.replay._history import CarryOver, read_runs
from pcmrs.replay._player import JournalPlayer
from pcmrs.replay._world import ReplayCell
from pcmrs.simulated_time.loop import SimulatedLoop
from pcmrs.workflows.opening import open_installed
from pcmrs.workflows.settings import ProcedureSettings
from tests.unit.replay.golden import GOLDEN

RUN = read_runs(GOLDEN / "ratms.jsonl")[0]
ROWS = RUN.decided()


def played(rows: list[StoredRow], see: Callable[[JournalPlayer, int], Awaitable[None]]) -> JournalPlayer:
    """Feeds rows to a new dispatcher, and shows it after each."""

    async def play() -> JournalPlayer:
        assert RUN.settings is not None
        cell = ReplayCell(msgspec.convert(RUN.settings["procedure"], ProcedureSettings), RUN.calibration)
        before = CarryOver()
        player = JournalPlayer(before.with_state(open_installed("ratms")), cell, rows, lease_required=False)
        before.restore(player.dispatcher, RUN)  # Stops are numbered by the run
        for index in range(len(rows)):
            await player.feed(index)
            await see(player, index)
        await player.end()
        assert asyncio.all_tasks() == {asyncio.current_task()}
        return player

    with asyncio.Runner(loop_factory=SimulatedLoop) as runner:
        return runner.run(play())


def test_each_row_is_decided_when_it_has_been_fed() -> None:
    async def see(player: JournalPlayer, index: int) -> None:
        found = player.recorder.decided(index)
        assert found is not None, ROWS[index].row
        assert found.states == (ROWS[index].row.states or {})
        if index + 40 < len(ROWS):
            return
        assert player.recorder.extra == []

    player = played(ROWS, see)
    assert 0 < player.answered < len(ROWS), "devices answered some commands, arguments and data decided the others"


def test_stop_is_latched_where_the_journal_has_it() -> None:
    stop = next(index for index, stored in enumerate(ROWS) if stored.row.operation == "stopped")
    latched: list[bool] = []

    async def see(player: JournalPlayer, index: int) -> None:
        latched.append(player.dispatcher.snapshot().latched)

    played(ROWS[: stop + 1], see)
    assert latched[stop]
    assert not latched[0]


def test_nothing_is_left_when_a_run_ends_in_an_activity() -> None:
    """A replay printed that a task was destroyed while it was pending."""
    followed = [index for index, stored in enumerate(ROWS) if stored.row.operation == "follow" and stored.row.verdict]
    activities: list[int] = []

    async def see(player: JournalPlayer, index: int) -> None:
        activities.append(len(player.dispatcher.snapshot().activities))

    played(ROWS[: followed[0] + 1], see)
    assert activities[-1] == 1


def test_a_row_of_which_the_cause_is_missing_is_not_decided() -> None:
    """A replay must say so, and go on."""
    strange = msgspec.structs.replace(ROWS[0].row, kind="outcome", branch="nowhere", operation="go", command_id="x")
    rows = [msgspec.structs.replace(ROWS[0], row=strange), *ROWS[:4]]
    decided: list[bool] = []

    async def see(player: JournalPlayer, index: int) -> None:
        decided.append(player.recorder.decided(index) is not None)

    played(rows, see)
    assert decided[1:] == [True] * 4
