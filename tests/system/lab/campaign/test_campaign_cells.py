"""Faults in real cells: those of a fault pass, and the same checks fail where nothing was injected."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from pathlib import Path

import pytest

from pcmrs.clock import SystemClock
from pcmrs.errors import DeviceError
from pcmrs.failpoints import FAILPOINTS
from pcmrs.testing.driving import accept, landmarks
from pcmrs.testing.errors import Unmet
from pcmrs_lab.campaign import daemonkills
from pcmrs_lab.campaign.checks import held, refused
from pcmrs_lab.campaign.consumer import consumer
from pcmrs_lab.campaign.driving import injected
from pcmrs_lab.campaign.faults.network_bus import BURST
from pcmrs_lab.campaign.injections import injections
from pcmrs_lab.campaign.lab import Lab, Pool
from pcmrs_lab.campaign.report import InjectionResult
from pcmrs_lab.campaign.run import run_injection

pytest.importorskip("mujoco")

pytestmark = [pytest.mark.nightly, pytest.mark.timeout(300)]


@pytest.fixture
async def pool(tmp_path: Path) -> AsyncIterator[Pool]:
    made = Pool(tmp_path)
    yield made
    await made.close()


async def inject(fault_id: str, name: str, folder: Path, pool: Pool) -> InjectionResult:
    (way,) = (way for way in injections()[fault_id] if way.name == name)
    return await run_injection(way, 1, folder, pool, SystemClock())


async def test_faults_of_a_cell_are_found_and_checks_fail_without_them(tmp_path: Path, pool: Pool) -> None:
    for fault_id, name in (("O10", "repeated"), ("O5", "collinear"), ("O2", "index_out_of_range")):
        part = await inject(fault_id, name, tmp_path, pool)
        assert part.outcome == "passed", part
        assert "control" in part.details
    lab = Lab(1, tmp_path, pool)
    async with lab.cell() as cell:
        with pytest.raises(Unmet, match=r"registration\.plan_landmarks was accepted"):
            await refused(cell, "registration.plan_landmarks", landmarks(), codes=("degenerate_points",))
        await accept(cell.client, "registration.plan_landmarks", **landmarks())
        nowhere = {"body": "pointer", "millimetres": 0.0}
        with pytest.raises(Unmet, match=r"digitization\.digitize_one was accepted"):
            async with injected(cell, "pose_jump", nowhere, nowhere):
                await refused(cell, "digitization.digitize_one", {"index": 0}, codes=("pose_stale",))
    assert len(pool.logs()) == 1, "one daemon served all of them"
    with pytest.raises(Unmet, match=r"within 0\.2 s"):
        async with lab.cell(fresh=False) as cell:
            await held(cell, within=0.2)
    assert cell.process.returncode is not None, "a daemon that an error has left in doubt is not used again"


async def test_busy_consumer_counts_the_messages_it_misses(tmp_path: Path, pool: Pool) -> None:
    async with Lab(1, tmp_path, pool).cell() as cell, consumer(cell, "busy") as go_on:
        await asyncio.sleep(1.0)
        found = await go_on()
    assert found.lost > 10 * BURST
    assert abs(found.lost - found.counted) <= BURST


async def test_a_daemon_that_refuses_to_start_says_why(tmp_path: Path) -> None:
    lab = Lab(1, tmp_path)
    status, errors = await lab.start_refused("robot.wheels=4")
    assert status == 4
    assert "wheels" in errors
    with pytest.raises(DeviceError, match="wheels"):
        async with lab.daemon("robot.wheels=4"):
            pytest.fail("must not start")


async def test_daemon_killed_by_its_failpoint_counts_as_killed_there() -> None:
    found = await daemonkills.kill_daemons(1, 1, SystemClock())
    assert (found.at, found.not_reached, found.violated) == ({FAILPOINTS[0]: 1}, {}, False)


async def test_daemon_that_misses_its_failpoint_is_not_counted_there(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(daemonkills, "LATEST", 1 << 40)
    monkeypatch.setattr(daemonkills, "DIES_WITHIN", 1.0)
    found = await daemonkills.kill_daemons(1, 1, SystemClock())
    assert (found.kills, found.at, found.not_reached) == (1, {}, {FAILPOINTS[0]: 1})
