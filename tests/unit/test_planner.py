"""The planner's client: a whole session, refusals, repetitions, signatures, and any reply."""

from __future__ import annotations

import asyncio
import contextlib
import subprocess
import sys
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pcmrs import planner as planner_module
from pcmrs.errors import CommandRefusedError, PayloadError, UnknownOutcomeError
from pcmrs.planner import Planner, parse_reply
from tests.unit.gateway.gateway_fakes import CONFIRMED
from tests.unit.gateway.open_cell import Cell, open_cell


@pytest.fixture
async def cell(tmp_path: Path) -> AsyncIterator[Cell]:
    async with open_cell(tmp_path) as opened:
        yield opened


async def test_a_planner_completes_the_workflow(cell: Any) -> None:
    cell.core.results = {"register": {"residual": 0.0021, "rms": 0.002}, "confirm": CONFIRMED}
    async with await Planner.open(*cell.planner) as planner:
        await planner.connect()
        await planner.plan_landmarks([[0.1, 0.0, 0.0], [0.0, 0.1, 0.0], [0.0, 0.0, 0.1]])
        await planner.digitize_all()
        assert await planner.register() == pytest.approx(2.1)
        await planner.plan_pose([0.1, 0.2, 0.3], [0.0, 0.0, 0.0, 1.0])
        await planner.approach()
        placed = await planner.confirm()
        await planner.back_off()
        await planner.home()
        await planner.stop()
    assert placed.position == (0.1, 0.2, 0.3)
    assert placed.translation_error_mm == pytest.approx(0.25)
    assert cell.core.operations == [
        "connect", "plan_landmarks", "digitize_all", "register", "plan", "approach", "confirm", "back_off", "home",
    ]  # fmt: skip


async def test_a_refusal_is_raised_with_its_reason(cell: Any) -> None:
    cell.core.refusals["register"] = "residual_too_large"
    async with await Planner.open(*cell.planner) as planner:
        with pytest.raises(CommandRefusedError, match="residual_too_large") as refusal:
            await planner.register()
    assert refusal.value.fields["verdict"].decision == "rejected"


class Deaf(asyncio.DatagramProtocol):
    """Answers a datagram only when it comes the second time, after some that mean nothing."""

    def __init__(self) -> None:
        self.heard: list[bytes] = []

    def connection_made(self, transport: Any) -> None:
        self.transport = transport

    def datagram_received(self, data: bytes, addr: tuple[Any, ...]) -> None:
        self.heard.append(data)
        if self.heard.count(data) == 2:
            client_id = data.split(b"#")[1].rstrip(b";")
            for answer in (b"ack", b"\xff", b"0_accepted_robot_1;", client_id + b"_accepted_robot_1;"):
                self.transport.sendto(answer, addr)


async def test_a_lost_command_is_repeated_with_the_same_id(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(planner_module, "REPEAT_AFTER", 0.01)
    transport, deaf = await asyncio.get_running_loop().create_datagram_endpoint(Deaf, local_addr=("127.0.0.1", 0))
    async with await Planner.open(*transport.get_extra_info("sockname")) as planner:
        assert (await planner.command("rob_conn_onxxxxx")).decision == "accepted"
        with pytest.raises(UnknownOutcomeError):
            await planner.command("rob_conn_offxxxx", timeout=0.0)
    assert len(set(deaf.heard[:2])) == 1
    transport.close()


def test_a_planner_needs_neither_numpy_nor_zenoh() -> None:
    code = "import sys, pcmrs.planner; sys.exit('numpy' in sys.modules or 'zenoh' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


@given(st.binary(max_size=100))
def test_the_planner_survives_any_reply(data: bytes) -> None:
    with contextlib.suppress(PayloadError):
        parse_reply(data)
