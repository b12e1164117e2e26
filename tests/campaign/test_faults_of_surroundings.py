"""Faults of network, processes, storage, clock and adversaries, injected into real daemons."""

from __future__ import annotations

from pathlib import Path

import pytest

from pcmrs.campaign.catalogue import choose
from pcmrs.campaign.fault import injections
from pcmrs.campaign.lab import Pool
from pcmrs.campaign.run import run_campaign, run_injection
from pcmrs.clock import SystemClock

CLASSES = ("network", "process", "storage", "clock", "adversary")
ROWS = [row for row in choose(CLASSES) if not row.access_control]
QUICK = ("N5", "A7")
"""On one daemon, in seconds."""


def test_every_row_that_needs_no_access_control_can_be_injected() -> None:
    assert not [row.id for row in ROWS if not injections().get(row.id)]


@pytest.mark.nightly
async def test_what_arrives_at_the_socket_does_no_harm() -> None:
    report = await run_campaign(choose((), QUICK), [0])
    assert {result.id: result.response for result in report.faults if result.outcome != "passed"} == {}


@pytest.mark.nightly
@pytest.mark.timeout(900)
@pytest.mark.parametrize("row", [row.id for row in ROWS])
async def test_every_fault_is_survived(row: str, tmp_path: Path) -> None:
    pool = Pool(tmp_path)
    try:
        parts = [await run_injection(injection, 1, tmp_path, pool, SystemClock()) for injection in injections()[row]]
    finally:
        await pool.close()
    assert not [part for part in parts if part.outcome == "failed"]
    if left_out := [part.response for part in parts if part.outcome == "not_run"]:
        pytest.skip("; ".join(left_out))
