"""Faults of order in real cells: a late request moves nothing, and a row whose fault does not take place fails."""

from __future__ import annotations

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path

import pytest

from pcmrs.campaign import delays
from pcmrs.campaign.catalogue import choose
from pcmrs.campaign.fault import injections
from pcmrs.campaign.lab import Pool
from pcmrs.campaign.report import Part
from pcmrs.campaign.run import run_injection
from pcmrs.clock import SystemClock

pytest.importorskip("mujoco")

pytestmark = pytest.mark.timeout(300)


@pytest.fixture
async def pool(tmp_path: Path) -> AsyncIterator[Pool]:
    made = Pool(tmp_path)
    yield made
    await made.close()


async def inject(fault_id: str, name: str, folder: Path, pool: Pool) -> Part:
    (way,) = (way for way in injections()[fault_id] if way.name == name)
    return await run_injection(way, 1, folder, pool, SystemClock())


def test_the_class_has_its_rows_and_each_is_injected() -> None:
    rows = [row.id for row in choose(["order"])]
    assert len(rows) >= 25
    assert not set(rows) - injections().keys()


def inject_nothing(patch: pytest.MonkeyPatch) -> None:
    """From now on no rule delays anything, and nobody waits long for that."""

    @asynccontextmanager
    async def nothing(*_: object, **__: object) -> AsyncIterator[None]:
        yield

    patch.setattr(delays.Delays, "delaying", nothing)
    patch.setattr(delays, "PATIENCE", 3.0)


def expect_not_taken_place(part: Part) -> None:
    assert part.outcome == "failed", part
    assert "did not take place" in part.response, part


async def test_a_request_that_arrives_after_the_hold_moves_nothing(
    tmp_path: Path, pool: Pool, monkeypatch: pytest.MonkeyPatch
) -> None:
    part = await inject("Q1", "delivered_late", tmp_path, pool)
    assert part.outcome == "passed", part
    assert part.details["took_place"]["delayed"] == 1
    assert part.details["overtaken_by"] >= 1
    inject_nothing(monkeypatch)
    expect_not_taken_place(await inject("Q1", "delivered_late", tmp_path, pool))


@pytest.mark.nightly
@pytest.mark.timeout(3000)
async def test_rows_fail_where_nothing_is_delayed(tmp_path: Path, pool: Pool, monkeypatch: pytest.MonkeyPatch) -> None:
    inject_nothing(monkeypatch)
    delayed = {"Q3", "Q7", "Q9", "Q10"}  # these take place without a delayed frame, and count otherwise
    for row in choose(["order"]):
        for way in injections()[row.id] if row.id not in delayed else ():
            expect_not_taken_place(await run_injection(way, 1, tmp_path, pool, SystemClock()))
