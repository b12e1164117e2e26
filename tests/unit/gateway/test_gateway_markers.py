from __future__ import annotations

import asyncio
from contextlib import closing
from pathlib import Path
from uuid import uuid4

import msgspec
import pytest

from pcmrs.devices.lsl.inlet import Inlet
from pcmrs.devices.lsl.library import load_lsl
from pcmrs.gateway.links import open_gateway
from pcmrs.gateway.settings import GatewayConfig, LinkConfig, MarkersConfig
from pcmrs.gateway.streams import Markers
from pcmrs.messages import DeviceEvent, Verdict
from tests.unit.gateway.gateway_fakes import FakeCore, ManualClock

NO_LINK = LinkConfig()
PATIENCE = 10.0  # s of the machine


@pytest.fixture(autouse=True)
def _outlets_live_on(monkeypatch: pytest.MonkeyPatch) -> None:
    """Until this process ends: liblsl 1.18 crashes now and then when one is destroyed that somebody reads."""
    monkeypatch.setattr(load_lsl().StreamOutlet, "__del__", lambda _: None)


def config(markers: MarkersConfig) -> GatewayConfig:
    return GatewayConfig(
        planner=NO_LINK, robot=NO_LINK, visualization=NO_LINK, mixed_reality=NO_LINK, mep=NO_LINK, tcp_port=None,
        markers=markers,
    )  # fmt: skip


def verdict(decision: str, result: dict[str, object] | None) -> Verdict:
    fields = {"id": "1", "branch": "stimulation", "operation": "fire", "state": "armed", "sequence": 2}
    return msgspec.convert({**fields, "decision": decision, "result": result}, Verdict)


async def test_states_stops_and_pulses_are_marked_in_order(tmp_path: Path) -> None:
    stream, core = f"markers-{uuid4().hex}", FakeCore()
    marked: list[str] = []
    with closing(Inlet(stream)) as inlet:
        async with open_gateway(core, config(MarkersConfig(enabled=True, stream=stream)), ManualClock(), tmp_path):
            async with asyncio.timeout(PATIENCE):
                while inlet.problem:
                    inlet.pull()
                    await asyncio.sleep(0.01)
            before = core.snapshot()
            core.publish(before)
            core.publish(DeviceEvent(device="robot", code="x", text=""))
            changed = {**before.branches, "robot": "0", "placement": "placed"}
            core.publish(msgspec.structs.replace(before, branches=changed))
            core.publish(verdict("accepted", {"pulse": 3}))
            core.publish(verdict("rejected", None))
            core.publish(verdict("failed", None))
            await core.stop("test")
            async with asyncio.timeout(PATIENCE):
                while len(marked) < 4:
                    marked += [text[0].decode() for text in inlet.pull()[0]]
                    await asyncio.sleep(0.01)
    assert marked == ["robot:1->0", "placement:retracted->placed", "pulse:3", "stop"]


async def test_they_are_off_unless_asked_for(tmp_path: Path) -> None:
    core = FakeCore()
    async with open_gateway(core, config(MarkersConfig()), ManualClock(), tmp_path):
        assert not any(isinstance(each, Markers) for each in core.listeners)


def test_the_table_is_checked() -> None:
    with pytest.raises(msgspec.ValidationError, match="name"):
        msgspec.convert({"markers": {"name": "x"}}, GatewayConfig)
