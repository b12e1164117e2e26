"""A daemon that knows robot and tracker by the drivers of real ones: at first nobody is there, then a virtual cell."""

from __future__ import annotations

import asyncio
from collections.abc import Iterator
from contextlib import aclosing
from pathlib import Path

import pytest

from pcmrs.client import Client
from pcmrs.messages import DeviceHealth, Snapshot
from pcmrs.testing.driving import accept, landmarks, moving, register, until
from tests.system.daemon.daemon_process import PATIENCE, PLAN, ServeProcess, own_settings, running_daemon
from tests.system.daemon.virtual_cell import VirtualCell

pytest.importorskip("mujoco")
pytest.importorskip("ndicapy")

pytestmark = pytest.mark.slow


@pytest.fixture
def cell(tmp_path: Path) -> VirtualCell:
    return VirtualCell(tmp_path)


@pytest.fixture
def daemon(cell: VirtualCell, tmp_path: Path) -> Iterator[ServeProcess]:
    """A daemon that was ready before the cell was there."""
    with running_daemon([*own_settings(tmp_path), *cell.settings], tmp_path) as daemon:
        yield daemon
        assert daemon.process.poll() is None
        assert "Traceback" not in daemon.log


async def until_told(client: Client, device: str, *, connected: bool) -> DeviceHealth:
    """What the device's node says of it, as soon as that is so."""
    told: asyncio.Future[DeviceHealth] = asyncio.get_running_loop().create_future()

    def look(health: DeviceHealth) -> None:
        if health.connected is connected and not told.done():
            told.set_result(health)

    client.listen(f"dev/{device}/state", DeviceHealth, look)
    async with asyncio.timeout(PATIENCE):
        return await told


async def register_by_hand(client: Client, cell: VirtualCell) -> None:
    """Connects, and registers the head, which a person touches whom nobody but the test tells where."""
    await accept(client, "robot.connect")
    await accept(client, "registration.plan_landmarks", **landmarks())
    digitizing = asyncio.create_task(accept(client, "digitization.digitize_all"))
    touched = 0
    async with asyncio.timeout(PATIENCE), aclosing(client.watch()) as events:
        async for event in events:
            if not isinstance(event, Snapshot):
                continue
            reached = [round(each.progress * len(PLAN["landmarks"])) for each in event.running]
            if reached == [touched]:
                cell.tell(f"touch {touched}")
                touched += 1
            if event.branches["digitization"] == "1":
                break
    await digitizing
    await accept(client, "registration.register")
    await accept(client, "toolplan.plan", **PLAN["poses"][0])


@pytest.mark.nightly
async def test_daemon_starts_without_devices_and_uses_them_once_there(daemon: ServeProcess, cell: VirtualCell) -> None:
    async with daemon.client() as client:
        assert "nothing listens there" in (await until_told(client, "tracker", connected=False)).text
        assert "connect it first" in (await until_told(client, "robot", connected=False)).text
        verdict = await client.call("robot.connect")
        assert (verdict.decision, verdict.state) == ("failed", "0")
        assert verdict.reason is not None
        assert "start the KST application on the smartPAD" in verdict.reason.text
        with cell.running():
            await until_told(client, "tracker", connected=True)
            await register_by_hand(client, cell)
            await accept(client, "placement.approach")
            placed = await accept(client, "placement.confirm")
            assert placed.result is not None
            assert placed.result["translation_error"] < 0.5e-3
            await accept(client, "placement.back_off")
            await accept(client, "placement.home")
            await accept(client, "robot.disconnect")


@pytest.mark.nightly
async def test_cell_lost_in_motion_latches_and_returns_changed(daemon: ServeProcess, cell: VirtualCell) -> None:
    async with daemon.client() as client:
        with cell.running():
            await until_told(client, "tracker", connected=True)
            await register_by_hand(client, cell)
            await register(client)
            async with moving(client) as approach:
                cell.kill()
                verdict = await approach
            assert verdict.decision in ("failed", "unknown")
            await until(client, lambda snapshot: snapshot.branches["robot"] == "0")
        state = await client.state()
        assert state.latched
        assert state.branches["placement"] == "unknown"
        for name in ("placement.approach", "placement.home", "placement.back_off", "robot.acknowledge"):
            refused = await client.call(name)
            assert refused.decision == "rejected"
            assert refused.reason is not None
        assert (await client.call("robot.connect")).decision == "failed"
        with cell.running():  # its arm is at home now, not where it was
            await until_told(client, "tracker", connected=True)
            await accept(client, "robot.connect")
            await until(client, lambda snapshot: snapshot.branches["placement"] == "retracted")
            await accept(client, "robot.acknowledge")
            await accept(client, "placement.approach")
