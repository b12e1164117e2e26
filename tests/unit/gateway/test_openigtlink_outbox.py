from __future__ import annotations

import asyncio
import socket
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from structlog.testing import capture_logs

from pcmrs.clock import SystemClock
from pcmrs.devices.plus.messages import matrix_mm
from pcmrs.errors import RefusalError
from pcmrs.gateway.links import open_gateway
from pcmrs.gateway.openigtlink import link, outbox, plans
from pcmrs.gateway.openigtlink.outbox import MAX_WAITING, Outbox
from pcmrs.gateway.settings import OpenIgtLinkConfig
from pcmrs.spatial import Transform, distance, rotation_angle
from tests.support import openigtlink_bytes as wire
from tests.unit.gateway.gateway_fakes import WITHIN
from tests.unit.gateway.igtl_client import Slicer, SlicerCore, planned_mm, slicer_only


class Receiver:
    """Takes the place of a connection whose other side reads when the test says so."""

    def __init__(self) -> None:
        self.sent: asyncio.Queue[bytes] = asyncio.Queue()
        self.reads = asyncio.Event()
        self.transport = self

    def set_write_buffer_limits(self, high: int) -> None:
        assert high == 0

    def write(self, data: bytes) -> None:
        self.sent.put_nowait(data)

    async def drain(self) -> None:
        await self.reads.wait()


async def test_of_each_pose_the_newest_waits_and_of_all_else_so_many() -> None:
    box, receiver = Outbox(), Receiver()
    sending = asyncio.create_task(box.send(receiver, SystemClock()))  # type: ignore[arg-type]
    box.put(b"first,")
    assert await receiver.sent.get() == b"first,"
    for number in range(MAX_WAITING + 3):
        box.put(b"%d," % number)
        box.put_pose("A", b"A%d," % number)
        box.put_pose("B", b"B%d," % number)
    assert box.dropped == 3 + 2 * (MAX_WAITING + 2)
    receiver.reads.set()
    expected = [b"%d" % number for number in range(3, MAX_WAITING + 3)]
    assert await receiver.sent.get() == b",".join([*expected, b"A102", b"B102", b""])
    sending.cancel()
    await asyncio.gather(sending, return_exceptions=True)


async def test_client_that_does_not_read_delays_nobody_and_is_cut_off(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(outbox, "STALLED_AFTER", 0.2)
    monkeypatch.setattr(link, "SEND_BUFFER", 4096)
    core = SlicerCore()
    config = slicer_only(OpenIgtLinkConfig(enabled=True, port=0, rate_hz=500.0))
    with capture_logs() as logs:
        async with open_gateway(core, config, SystemClock(), tmp_path) as gateway:
            idle = socket.socket()
            idle.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
            idle.connect(gateway.addresses["openigtlink"])
            reading = await Slicer.connect(gateway.addresses["openigtlink"])
            async with asyncio.timeout(WITHIN):
                while not (stalled := [each for each in logs if each["event"] == "openigtlink_stalled"]):
                    # The one that reads is served all the while.
                    await reading.next("CoilToImage")
            reading.send(wire.transform("ToolTargetToImage", planned_mm()))
            assert await reading.verdict() == "accepted toolplan.plan"
            reading.close()
            idle.close()
    assert stalled[0]["dropped"] > 0


finite = st.floats(width=32)


def planned(plan: Callable[..., Any], *sent: Any) -> Any:
    """The arguments, or None where they are refused with a reason."""
    try:
        return plan(*sent)
    except RefusalError as refusal:
        return None if refusal.text and refusal.refusal_code else "no reason"


@given(st.lists(finite, min_size=12, max_size=12))
def test_a_matrix_is_a_plan_or_is_refused(numbers: list[float]) -> None:
    arguments = planned(plans.target, np.vstack([np.array(numbers).reshape(3, 4), [0.0, 0.0, 0.0, 1.0]]))
    if arguments is not None:
        assert np.linalg.norm(arguments["quat_xyzw"]) == pytest.approx(1.0)
        assert np.linalg.norm(arguments["position"]) * 1e3 >= plans.NEAREST_MM
        assert max(np.abs(arguments["position"])) * 1e3 <= plans.FARTHEST_MM


@given(
    st.lists(st.floats(-1000.0, 1000.0, width=32), min_size=3, max_size=3),
    st.lists(st.floats(-3.0, 3.0), min_size=3, max_size=3),
)
def test_a_rigid_matrix_in_mm_is_the_same_plan_in_metres(position_mm: list[float], rotvec: list[float]) -> None:
    sent = Transform.from_rotvec(np.array(position_mm) * 1e-3, rotvec)
    arguments = planned(plans.target, matrix_mm(sent).astype(np.float32))
    if np.linalg.norm(position_mm) > 1.01 * plans.NEAREST_MM:
        taken = Transform.from_quat_xyzw(arguments["position"], arguments["quat_xyzw"])
        assert distance(sent, taken) < 1e-6
        assert rotation_angle(sent, taken) < 1e-6


@given(st.lists(st.tuples(finite, finite, finite), max_size=6))
def test_points_are_a_plan_or_are_refused(positions: list[tuple[float, float, float]]) -> None:
    arguments = planned(plans.landmarks, positions, [""] * len(positions))
    if arguments is not None:
        found = np.array([landmark["position"] for landmark in arguments["landmarks"]])
        np.testing.assert_allclose(found * 1e3, np.array(positions), rtol=1e-9, atol=1e-9)
        assert len(found) >= plans.FEWEST
