"""A repeated id runs nothing, however much the gateway has forgotten in between."""

from __future__ import annotations

import asyncio
from typing import Any

import pytest

from pcmrs.dispatcher import verdict_cache
from pcmrs.dispatcher.verdict_cache import CommandCache
from pcmrs.gateway import intake
from pcmrs.gateway.command_outcome import CommandOutcome
from pcmrs.gateway.links import open_gateway
from tests.unit.gateway.gateway_fakes import UdpClient


@pytest.fixture
def sessions_are_forgotten(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(intake, "MAX_SESSIONS", 1)


@pytest.fixture
def outcomes_are_forgotten(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(verdict_cache, "MAX_REMEMBERED", 1)


async def hear_from_another(cell: Any) -> None:
    """Another peer's command; the session and the outcomes of the first are no longer the newest."""
    other = await UdpClient.open()
    await other.ask("get_jnt_angsxxxx_#1;", cell.planner)
    other.transport.close()


@pytest.mark.usefixtures("sessions_are_forgotten")
@pytest.mark.parametrize("refused_by_gateway", [True, False])
async def test_the_verdict_outlives_the_session(cell: Any, refused_by_gateway: bool) -> None:
    if refused_by_gateway:
        await cell.ask("target_rotxxxxxx_0_0_0_1_#1;")
    first = await cell.ask("execute_motionxx_#2;")
    ran = list(cell.core.operations)
    await cell.ask("target_rotxxxxxx_0_0_0_1_#3;")
    await cell.ask("target_tslxxxxxx_0_0_0_#4;")
    await hear_from_another(cell)
    assert await cell.ask("execute_motionxx_#2;") == first
    assert cell.core.operations == [*ran, "plan"]


@pytest.mark.usefixtures("sessions_are_forgotten", "outcomes_are_forgotten")
async def test_the_daemon_recognises_what_the_gateway_forgot(cell: Any) -> None:
    first = await cell.ask("execute_motionxx_#1;")
    await hear_from_another(cell)
    assert await cell.ask("execute_motionxx_#1;") == first
    assert cell.core.operations == ["approach"]


@pytest.mark.usefixtures("sessions_are_forgotten", "outcomes_are_forgotten")
@pytest.mark.parametrize(("before", "after"), [("retracted", "placed"), ("placed", "retracted")])
async def test_forgotten_command_that_would_now_differ_runs_nothing(cell: Any, before: str, after: str) -> None:
    cell.core.branches["placement"] = before
    assert (await cell.ask("end_session_back_#1;")).startswith("1_accepted")
    ran = list(cell.core.operations)
    await hear_from_another(cell)
    cell.core.branches["placement"] = after
    assert (await cell.ask("end_session_back_#1;")).endswith("_id_reused;")
    assert cell.core.operations == ran


async def test_ids_are_forgotten_at_each_opening(cell: Any, tmp_path: Any) -> None:
    async with open_gateway(cell.core, cell.config, cell.clock, tmp_path) as gateway:
        await cell.ask("rob_conn_onxxxxx_#1;", gateway.addresses["planner"])
    await cell.ask("rob_conn_onxxxxx_#1;")
    assert cell.core.operations == ["connect", "connect"]


@pytest.mark.usefixtures("outcomes_are_forgotten")
async def test_a_command_under_way_is_not_forgotten() -> None:
    remembered: CommandCache[asyncio.Future[CommandOutcome]] = CommandCache()
    loop = asyncio.get_running_loop()
    running, done = loop.create_future(), loop.create_future()
    done.set_result(CommandOutcome("accepted", "robot", "1"))
    remembered.put("a", "1", running)
    remembered.put("a", "2", done)
    remembered.put("a", "3", done)
    assert remembered.get("a", "1") is running
    assert remembered.get("a", "2") is None
