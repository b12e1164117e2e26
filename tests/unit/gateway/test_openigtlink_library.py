"""Both roles against the library's own server and client: its framing, its threads, its polling."""

from __future__ import annotations

import asyncio
import json
import signal
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pyigtl
import pytest

from pcmrs.clock import SystemClock
from pcmrs.devices.plus.messages import matrix_mm
from pcmrs.gateway.links import open_gateway
from pcmrs.gateway.openigtlink import link
from pcmrs.gateway.settings import GatewayConfig, OpenIgtLinkConfig
from tests.unit.gateway.igtl_client import SEEN, SlicerCore, planned_mm, slicer_only


def config(**values: Any) -> GatewayConfig:
    return slicer_only(OpenIgtLinkConfig(enabled=True, **values))


async def talk(other: Any, core: SlicerCore, x_mm: float) -> None:
    """Poses and state one way, a plan and its verdict the other."""

    async def wait_for(name: str) -> Any:
        message = await asyncio.to_thread(other.wait_for_message, name, 20.0)
        assert message is not None, f"no {name}"
        return message

    coil = await wait_for("CoilToTracker")
    np.testing.assert_allclose(coil.matrix, matrix_mm(SEEN["coil"]), atol=1e-3)
    assert json.loads((await wait_for("PcmrsState")).string)["branches"] == core.branches
    plan = pyigtl.TransformMessage(planned_mm((x_mm, 60.0, 80.0)), device_name="ToolTargetToImage")
    other.send_message(plan, wait=False)
    assert (await wait_for("PcmrsVerdict")).string == "accepted toolplan.plan"
    assert core.commands[-1].arguments["position"] == pytest.approx([x_mm * 1e-3, 0.06, 0.08])
    points = pyigtl.PointMessage(
        [[80.0 + x_mm, 0.0, 0.0], [-80.0, 0.0, 0.0], [0.0, 90.0, 0.0]], device_name="Landmarks"
    )
    other.send_message(points, wait=False)
    assert (await wait_for("PcmrsVerdict")).string == "accepted registration.plan_landmarks"
    assert [landmark["name"] for landmark in core.commands[-1].arguments["landmarks"]] == ["p0", "p1", "p2"]


async def test_the_library_s_client_is_served(tmp_path: Path) -> None:
    core = SlicerCore()
    async with open_gateway(core, config(port=0), SystemClock(), tmp_path) as gateway:
        client = pyigtl.OpenIGTLinkClient(*gateway.addresses["openigtlink"])
        await talk(client, core, 40.0)
        await asyncio.to_thread(client.stop)


@pytest.fixture
def serve() -> Iterator[Callable[[int], Any]]:
    """Makes servers of the library, which put handlers of their own on the signals of the process."""
    kept = {number: signal.getsignal(number) for number in (signal.SIGTERM, signal.SIGINT)}
    yield lambda port: pyigtl.OpenIGTLinkServer(port=port)
    for number, handler in kept.items():
        signal.signal(number, handler)


async def test_library_server_is_connected_to_again_when_it_returns(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, serve: Callable[[int], Any]
) -> None:
    monkeypatch.setattr(link, "RETRY_AFTER", 0.01)
    core, server = SlicerCore(), serve(0)
    port = server.server_address[1]
    async with open_gateway(core, config(role="client", port=port), SystemClock(), tmp_path) as gateway:
        assert gateway.addresses["openigtlink"] == ("127.0.0.1", port)
        await talk(server, core, 40.0)
        await asyncio.to_thread(server.stop)
        server = serve(port)
        await talk(server, core, 50.0)
    await asyncio.to_thread(server.stop)
    assert core.operations == ["plan", "plan_landmarks"] * 2
