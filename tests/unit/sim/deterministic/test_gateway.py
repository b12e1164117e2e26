"""String commands without sockets: they reach the daemon like datagrams of the planner."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any, cast

import pytest

from pcmrs.gateway.settings import GatewayConfig
from pcmrs_sim.deterministic.gateway import SimulatedGateway
from tests.unit.gateway.gateway_fakes import FakeCore, ManualClock

PORT = 5000


class Planner:
    """A planner at a port, and the daemon behind its gateway."""

    def __init__(self, core: FakeCore, gateway: SimulatedGateway) -> None:
        self.core, self.gateway = core, gateway
        self.verdicts: list[str] = []
        self.acknowledgements: list[str] = []

    async def send(self, text: str, port: int = PORT, *, old: bool = False) -> None:
        acknowledge = self.acknowledgements.append if old else None
        self.gateway.receive(port, text.encode(), self.verdicts.append, acknowledge)
        for _ in range(50):
            await asyncio.sleep(0)


@pytest.fixture
async def planner(tmp_path: Path) -> AsyncIterator[Planner]:
    core = FakeCore()
    gateway = SimulatedGateway(cast(Any, core), GatewayConfig(), cast(Any, ManualClock()), tmp_path)
    yield Planner(core, gateway)
    core.open_gates()
    await gateway.close()


async def test_a_command_is_submitted_and_its_verdict_is_answered(planner: Planner) -> None:
    await planner.send("rob_conn_onxxxxx_#1;")
    assert planner.core.operations == ["connect"]
    (verdict,) = planner.verdicts
    assert verdict.startswith("1_accepted")


async def test_a_repeated_id_runs_once_and_has_the_same_answer(planner: Planner) -> None:
    await planner.send("rob_conn_onxxxxx_#1;")
    await planner.send("rob_conn_onxxxxx_#1;")
    assert planner.core.operations == ["connect"]
    assert len(set(planner.verdicts)) == 1
    assert len(planner.verdicts) == 2


async def test_a_command_without_an_id_is_acknowledged_to_old_clients(planner: Planner) -> None:
    await planner.send("rob_conn_onxxxxx;", old=True)
    assert planner.core.operations == ["connect"]
    assert planner.acknowledgements == ["ack"]
    assert planner.verdicts == []


async def test_what_is_no_command_runs_nothing(planner: Planner) -> None:
    await planner.send("open_the_window_#1;")
    await planner.send("")
    assert planner.core.operations == []


async def test_after_its_end_no_task_is_left(planner: Planner) -> None:
    planner.core.gates["connect"].clear()
    await planner.send("rob_conn_onxxxxx_#1;")
    assert planner.verdicts == []
    before = len(asyncio.all_tasks())
    planner.core.open_gates()
    await planner.gateway.close()
    assert len(asyncio.all_tasks()) < before
