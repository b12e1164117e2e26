"""Force between tool and body, over the real bus: as much as asked for, and too much of it is danger at any time."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Iterator
from typing import Any

import pytest

from pcmrs.client import Client
from pcmrs.clock import SystemClock
from pcmrs.devices.remote import RemoteScene
from pcmrs.messages import JointState
from pcmrs.testing.driving import accept, showing, to_standoff, until, wait_until_stationary
from pcmrs.workflows.data import as_transform
from tests.system.daemon.daemon_process import PATIENCE, ServeProcess, own_settings, running_daemon

LIMIT = 8.0
RELIEF = 0.004


@pytest.fixture(scope="module")
def pressing_daemon(tmp_path_factory: pytest.TempPathFactory) -> Iterator[ServeProcess]:
    """One whose robot stops at `LIMIT` and gives way by `RELIEF`, in the machine's time."""
    folder = tmp_path_factory.mktemp("cell")
    settings = ["cell.rate=1", f"robot.force_limit={LIMIT}", f"robot.relief_mm={RELIEF * 1000}"]
    with running_daemon([*own_settings(folder), *settings], folder) as daemon:
        yield daemon
        assert "Traceback" not in daemon.log


class Bedside:
    """A coil at the head, and a hand that moves the head.

    Attributes:
        alarms: Fields of every ``force_limit`` that came, in order.
        moving: Set while the arm moves.
    """

    def __init__(self, client: Client, scene: RemoteScene) -> None:
        self.client = client
        self.scene = scene
        self.alarms: asyncio.Queue[dict[str, Any]] = asyncio.Queue()
        self.moving = asyncio.Event()
        client.listen("state/event", dict, self._hear)
        client.listen("state/joints", JointState, self._see)

    async def place(self) -> None:
        """From wherever the coil is to its place at the head, anew."""
        await wait_until_stationary(self.client)
        await to_standoff(self.client)
        await accept(self.client, "placement.confirm")

    async def push(self, depth: float) -> None:
        """Shifts the head against the coil, along the coil's axis, m."""
        axis = as_transform((await self.scene.truth()).tracker_from_coil).rotation[:, 2]
        x, y, z = (depth * axis).tolist()
        await self.scene.move_body((x, y, z))

    async def alarm(self) -> dict[str, Any]:
        """The next alarm, of which the daemon has latched by then."""
        async with asyncio.timeout(PATIENCE):
            fields = await self.alarms.get()
        await until(self.client, showing(placement="held"))
        assert (await self.client.state()).latched
        return fields

    async def force(self) -> float:
        return (await self.scene.truth()).contact_force

    def _see(self, state: JointState) -> None:
        if state.moving:
            self.moving.set()
        else:
            self.moving.clear()

    def _hear(self, event: dict[str, Any]) -> None:
        if event.get("code") == "force_limit":
            self.alarms.put_nowait(event["fields"])


@pytest.fixture
async def bedside(pressing_daemon: ServeProcess) -> AsyncIterator[Bedside]:
    async with pressing_daemon.client() as client, pressing_daemon.bus() as bus:
        bedside = Bedside(client, RemoteScene(bus, SystemClock()))
        await bedside.place()
        yield bedside


@pytest.mark.nightly
async def test_the_coil_presses_as_asked(bedside: Bedside) -> None:
    verdict = await accept(bedside.client, "placement.press", force=3.0)
    assert verdict.result is not None
    assert verdict.result["force"] == pytest.approx(3.0, abs=0.5)
    assert await bedside.force() == pytest.approx(3.0, abs=0.5)
    assert verdict.state == "placed"
    assert bedside.alarms.empty()


@pytest.mark.nightly
async def test_a_head_that_leans_on_the_coil_stops_and_latches(bedside: Bedside) -> None:
    for _ in range(20):
        await bedside.push(0.001)
        await asyncio.sleep(0.3)  # a person is no quicker, and feels the coil give way
        if not bedside.alarms.empty():
            break
    fields = await bedside.alarm()
    assert fields["limit"] == LIMIT
    assert LIMIT < fields["force"] < LIMIT + 3.0
    assert 0.0 < fields["relieved"] <= RELIEF + 1e-4
    assert await bedside.force() < LIMIT
    assert (await bedside.client.call("placement.back_off")).decision == "rejected"
    await accept(bedside.client, "robot.acknowledge")
    await accept(bedside.client, "placement.back_off")
    assert await bedside.force() == 0.0


@pytest.mark.nightly
async def test_too_much_force_ends_a_press(bedside: Bedside) -> None:
    await accept(bedside.client, "placement.nudge", translation=[0.0, 0.0, 0.008])
    press = asyncio.create_task(bedside.client.call("placement.press", {"force": 1.0}))
    async with asyncio.timeout(PATIENCE):
        await bedside.moving.wait()
    await bedside.push(0.025)
    verdict = await press
    assert (verdict.decision, verdict.state) == ("failed", "held")
    assert verdict.reason is not None
    assert verdict.reason.code == "force_limit"
    fields = await bedside.alarm()
    assert fields["force"] > LIMIT
    assert 0.0 < fields["relieved"] <= RELIEF + 1e-4, "declared as what this operation did against it"
