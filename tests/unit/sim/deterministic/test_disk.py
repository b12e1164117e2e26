"""The simulated disk: rows become durable, and the loop learns of them, in the order in which they were appended."""

from __future__ import annotations

import asyncio
from functools import partial
from pathlib import Path

import pytest

from pcmrs.journal import JournalRow
from pcmrs.messages import BlueprintTag
from pcmrs.testing.loop import run_on_simulated_loop
from pcmrs_sim.deterministic.disk import Disk, SimulatedJournal


def row(name: str) -> JournalRow:
    """An event of a device."""
    tag = BlueprintTag(id="test", version="1", hash="0")
    return JournalRow(
        kind="device", wall=0.0, monotonic=0.0, boot_id="boot", session_id="session", blueprint=tag, operation=name
    )


def windows(lasting: dict[str, float]) -> Disk:
    """A disk on which the named windows last so long, s, and all others no time."""
    return Disk(window=lambda name: lasting.get(name, 0.0))


def told_of(folder: Path, disk: Disk, pause: float) -> list[tuple[str, float]]:
    """When the loop learns of the rows ``first`` and ``second``, appended with a pause (s) between them."""
    told: list[tuple[str, float]] = []

    async def play() -> None:
        loop = asyncio.get_running_loop()
        journal = SimulatedJournal.on_disk(folder / "journal.sqlite", disk)
        begun, appended = loop.time(), list[asyncio.Future[int]]()

        def tell(name: str, _: object) -> None:
            told.append((name, round(loop.time() - begun, 6)))

        for name in ("first", "second"):
            appended.append(journal.append([row(name)]))
            appended[-1].add_done_callback(partial(tell, name))
            await asyncio.sleep(pause)
        await asyncio.wait(appended)
        await asyncio.sleep(0)
        await journal.close()

    run_on_simulated_loop(play())
    return told


def test_a_disk_that_is_in_order_takes_no_time(tmp_path: Path) -> None:
    assert told_of(tmp_path, Disk(), 0.1) == [("first", 0.0), ("second", 0.1)]


@pytest.mark.parametrize("window", ["write:device:first", "written:device:first"])
def test_nobody_learns_of_a_later_row_first(tmp_path: Path, window: str) -> None:
    """One thread writes, and tells the loop, as with the real journal: a row never overtakes an earlier one."""
    assert told_of(tmp_path, windows({window: 0.5}), 0.1) == [("first", 0.5), ("second", 0.5)]


def test_a_row_waits_no_longer_than_for_those_before_it(tmp_path: Path) -> None:
    lasting = {"written:device:first": 0.05, "write:device:second": 0.2, "written:device:second": 0.3}
    assert told_of(tmp_path, windows(lasting), 0.1) == [("first", 0.05), ("second", 0.6)]
