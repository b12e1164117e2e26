"""Streams to clients and markers: units, rates, and values that are unknown."""

from __future__ import annotations

import asyncio
from contextlib import closing
from pathlib import Path
from uuid import uuid4

import msgspec
import numpy as np
import pytest
from hypothesis import given
from scipy.spatial.transform import Rotation
from structlog.testing import capture_logs

from pcmrs.background import BackgroundTasks
from pcmrs.devices.lsl.inlet import Inlet
from pcmrs.devices.lsl.library import load_lsl
from pcmrs.gateway.links import open_gateway
from pcmrs.gateway.periodic_timer import beats_of
from pcmrs.gateway.settings import GatewayConfig, LinkConfig, MarkersConfig
from pcmrs.gateway.streams import Markers, Streams, point_message, pose_message, unity_message
from pcmrs.messages import DeviceEvent, Verdict
from pcmrs.spatial import Transform
from tests.unit.gateway.gateway_fakes import POINTS, POSE, ROTVECS, WITHIN, FakeCore, ManualClock

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


SWAP_YZ = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, 1.0, 0.0]])


def test_messages_are_in_mm_with_five_decimals() -> None:
    assert pose_message(POSE) == "__msg_pose_10.00000_20.00000_30.00000_0.50000_0.50000_0.50000_0.50000"
    assert point_message(np.array([0.1, -0.2, 1e-6])) == "__msg_point_100.00000_-200.00000_0.00100"


@given(POINTS, ROTVECS)
def test_unity_sees_the_mirrored_pose(position: tuple[float, ...], rotvec: tuple[float, ...]) -> None:
    pose = Transform.from_rotvec(position, rotvec)
    numbers = [float(token) for token in unity_message("crnt_", pose).removeprefix("crnt_").split("_")]
    np.testing.assert_allclose(numbers[:3], SWAP_YZ @ pose.translation, atol=1e-7)
    np.testing.assert_allclose(
        Rotation.from_quat(numbers[3:]).as_matrix(), SWAP_YZ @ pose.rotation @ SWAP_YZ, atol=1e-6
    )


class Sent:
    """Collects what a stream sends, by port."""

    def __init__(self) -> None:
        self.messages: list[tuple[str, int]] = []
        self._grown = asyncio.Event()

    def __call__(self, text: str, host: str, port: int) -> None:
        self.messages.append((text, port))
        self._grown.set()

    async def wait(self, count: int) -> None:
        async with asyncio.timeout(WITHIN):
            while len(self.messages) < count:
                self._grown.clear()
                await self._grown.wait()

    def to(self, port: int) -> list[str]:
        return [text.split("_")[0] if port == 8051 else text for text, to in self.messages if to == port]


async def test_pose_stream_keeps_its_rate_and_sends_unity_plans_once() -> None:
    core, clock, sent, tasks = FakeCore(), ManualClock(), Sent(), BackgroundTasks()
    config = GatewayConfig(stream_rate_hz=100.0)
    streams = Streams(core, beats_of(clock), config, sent, tasks)
    began = clock.now
    streams.start_poses()
    streams.start_poses()
    await sent.wait(51)
    assert clock.now - began == pytest.approx((len(sent.to(8079)) - 1) * 0.01, abs=0.011)
    assert sent.to(8051) == ["trgt"]  # not registered: no current pose, no registration
    core.branches["registration"] = "111"
    core.target = Transform.identity()
    sent.messages.clear()
    await sent.wait(20)
    assert set(sent.to(8051)) == {"crnt", "trgt"}
    assert sent.to(8051).count("trgt") == 1
    streams.stop_poses()
    sent.messages.clear()
    streams.start_tip()
    await sent.wait(3)
    assert {port for _, port in sent.messages} == {8083}
    streams.stop_tip()
    await tasks.close()


async def test_a_stream_outlives_a_network_that_is_down() -> None:
    sent, tasks = Sent(), BackgroundTasks()
    failures = 3

    def send(text: str, host: str, port: int) -> None:
        nonlocal failures
        failures -= 1
        if failures >= 0:
            raise OSError(101, "Network is unreachable")
        sent(text, host, port)

    streams = Streams(FakeCore(), beats_of(ManualClock()), GatewayConfig(), send, tasks)
    with capture_logs() as logged:
        streams.start_tip()
        await sent.wait(2)
    assert [entry["reason"] for entry in logged] == ["[Errno 101] Network is unreachable"]
    await tasks.close()


async def test_a_display_without_a_port_is_sent_nothing() -> None:
    sent, tasks = Sent(), BackgroundTasks()
    config = GatewayConfig(mixed_reality=LinkConfig())
    streams = Streams(FakeCore(), beats_of(ManualClock()), config, sent, tasks)
    streams.start_poses()
    await sent.wait(10)
    assert {port for _, port in sent.messages} == {8079}
    await tasks.close()


async def test_an_unknown_pose_is_left_out() -> None:
    core, sent, tasks = FakeCore(), Sent(), BackgroundTasks()
    core.pose = None
    streams = Streams(core, beats_of(ManualClock()), GatewayConfig(), sent, tasks)
    streams.start_poses()
    await sent.wait(1)
    assert sent.to(8079) == []
    await tasks.close()
