"""Faults of order in real cells: a late request moves nothing, and a row whose fault does not take place fails."""

from __future__ import annotations

from collections.abc import AsyncIterator
from pathlib import Path

import pytest

from pcmrs.clock import SystemClock
from pcmrs.testing.errors import Unmet
from pcmrs_lab.campaign import delays
from pcmrs_lab.campaign.catalogue import choose
from pcmrs_lab.campaign.fault import Injection
from pcmrs_lab.campaign.injections import injections
from pcmrs_lab.campaign.lab import Pool
from pcmrs_lab.campaign.run import run_injection
from pcmrs_lab.campaign.sham import sham

pytest.importorskip("mujoco")

pytestmark = pytest.mark.timeout(300)


@pytest.fixture
async def pool(tmp_path: Path) -> AsyncIterator[Pool]:
    made = Pool(tmp_path)
    yield made
    await made.close()


async def expect_found_out(way: Injection, folder: Path, pool: Pool) -> None:
    """A row whose fault does not take place says so by itself."""
    with sham():
        part = await run_injection(way, 1, folder, pool, SystemClock())
    assert part.outcome == "not_proved" or part.details.get("error") == Unmet.code, part


async def test_a_request_that_arrives_after_the_hold_moves_nothing(
    tmp_path: Path, pool: Pool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It and one more row fail where nothing is delayed; one daemon serves all."""
    (way,) = (way for way in injections()["Q1"] if way.name == "delivered_late")
    part = await run_injection(way, 1, tmp_path, pool, SystemClock())
    assert part.outcome == "passed", part
    assert part.details["took_place"]["delayed"] == 1
    assert part.details["overtaken_by"] >= 1
    monkeypatch.setattr(delays, "PATIENCE", 3.0)
    (outdated,) = injections()["Q4"]
    for each in (way, outdated):
        await expect_found_out(each, tmp_path, pool)
    assert len(pool.logs()) == 1


@pytest.mark.nightly
@pytest.mark.timeout(3000)
async def test_rows_fail_where_nothing_is_delayed(tmp_path: Path, pool: Pool, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(delays, "PATIENCE", 3.0)
    for row in choose(["order"]):
        for way in injections()[row.id]:
            await expect_found_out(way, tmp_path, pool)
