"""An existing client that knows nothing of PCMRS: one socket to send, fixed ports to listen, any datagram is an ack."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

import numpy as np
import pytest

from pcmrs.client import Client
from pcmrs.spatial import Transform
from pcmrs.testing.driving import accept, showing, until
from tests.system.daemon.daemon_process import PLAN, ServeProcess

ACK_WITHIN = 0.5
SECOND_WITHIN = 0.4


class Listener(asyncio.DatagramProtocol):
    def __init__(self) -> None:
        self.received: asyncio.Queue[str] = asyncio.Queue()

    def datagram_received(self, data: bytes, _: object) -> None:
        self.received.put_nowait(data.decode("ascii"))


class LabClient:
    """Sends a command, and raises when nothing comes back in the time that the existing modules wait."""

    def __init__(self, daemon: ServeProcess, sender: asyncio.DatagramTransport, listeners: dict[str, Listener]) -> None:
        self._links = daemon.ready.links
        self._sender = sender
        self._listeners = listeners

    async def tell(self, link: str, command: str) -> None:
        self._sender.sendto(command.encode("ascii"), self._links[link])
        assert await self.next(link, ACK_WITHIN) == "ack"

    async def ask(self, link: str, command: str) -> str:
        await self.tell(link, command)
        return await self.next(link, SECOND_WITHIN)

    async def next(self, link: str, within: float) -> str:
        async with asyncio.timeout(within):
            return await self._listeners[link].received.get()

    def quiet(self) -> bool:
        return all(listener.received.empty() for listener in self._listeners.values())


@asynccontextmanager
async def _lab_client(daemon: ServeProcess) -> AsyncIterator[LabClient]:
    loop = asyncio.get_running_loop()
    listeners, transports = {}, []
    for link in ("planner", "robot"):
        address = ("127.0.0.1", daemon.reply_port(link))
        transport, listeners[link] = await loop.create_datagram_endpoint(Listener, local_addr=address)
        transports.append(transport)
    sender, _ = await loop.create_datagram_endpoint(asyncio.DatagramProtocol, local_addr=("127.0.0.1", 0))
    try:
        yield LabClient(daemon, sender, listeners)
    finally:
        for transport in (*transports, sender):
            transport.close()


def _plan_of_landmarks() -> list[str]:
    points = [landmark["position"] for landmark in PLAN["landmarks"]]
    numbered = [f"img_fid_pntxxxxx_{index:02d}_{x:.15f}_{y:.15f}_{z:.15f};" for index, (x, y, z) in enumerate(points)]
    return [f"img_fid_numxxxxx_{len(points):02d};", *numbered, "img_fid_lastrecv;"]


def _plan_of_pose(number: int, beside: float = 0.0) -> list[str]:
    """Bytes of a target of the plan, or of one beside it along the coil's x axis, m."""
    pose = PLAN["poses"][number]
    if beside:
        image_from_coil = Transform.from_quat_xyzw(pose["position"], pose["quat_xyzw"])
        position = image_from_coil @ np.array([beside, 0.0, 0.0])
        pose = {"position": position.tolist(), "quat_xyzw": pose["quat_xyzw"]}
    rotation = "_".join(f"{value:.15f}" for value in pose["quat_xyzw"])
    translation = "_".join(f"{value:.15f}" for value in pose["position"])
    return [f"target_rotxxxxxx_{rotation};", f"target_tslxxxxxx_{translation};"]


async def test_the_workflow_with_fixed_reply_ports(daemon: ServeProcess, client: Client) -> None:
    async with _lab_client(daemon) as lab:
        assert await lab.ask("robot", "get_jnt_angsxxxx;") == "no_data_returned;"
        await lab.tell("robot", "rob_conn_onxxxxx;")
        await until(client, showing(robot="1", placement="retracted"))
        joints = await lab.ask("robot", "get_jnt_angsxxxx;")
        assert joints.endswith("_")
        assert len(joints.removesuffix("_").split("_")) == 7
        assert len((await lab.ask("robot", "get_eff_posexxxx;")).removesuffix("_").split("_")) == 7
        assert len((await lab.ask("robot", "get_jnt_setinitx;")).removesuffix("_").split("_")) == 7

        assert await lab.ask("planner", "start_registrati;") == "no_data_returned;"
        for command in _plan_of_landmarks():
            await lab.tell("planner", command)
        await until(client, showing(registration="100"))
        await lab.tell("planner", "start_autodigitz;")
        await until(client, showing(digitization="1"))
        assert 0.1 < float(await lab.ask("planner", "start_registrati;")) < 4.0
        for command in _plan_of_pose(0):
            await lab.tell("planner", command)
        await until(client, showing(toolplan="1"))
        await lab.tell("robot", "execute_motionxx;")
        await until(client, showing(placement="standoff"))
        await lab.tell("robot", "execute_confirmx;")
        await until(client, showing(placement="placed"))
        await lab.tell("robot", "execute_bkoffset;")
        await until(client, showing(placement="standoff"))
        await lab.tell("robot", "execute_homexxxx;")
        await until(client, showing(placement="retracted"))
        assert lab.quiet()


async def test_after_a_refused_plan_no_motion_goes_to_the_old_target(daemon: ServeProcess, client: Client) -> None:
    async with _lab_client(daemon) as lab:
        for command in _plan_of_landmarks():
            await lab.tell("planner", command)
        await until(client, showing(registration="100"))
        await accept(client, "robot.connect")
        await accept(client, "digitization.digitize_all")
        await accept(client, "registration.register")
        for command in _plan_of_pose(0):
            await lab.tell("planner", command)
        await until(client, showing(toolplan="1", placement="retracted"))
        plan = (await client.state()).plan
        await lab.tell("planner", "target_rotxxxxxx_0.0_0.0_0.0_1.0;")
        await lab.tell("planner", "target_tslxxxxxx_120.0_0.0_80.0;")
        await lab.tell("robot", "execute_motionxx;")
        await lab.ask("robot", "get_jnt_angsxxxx;")
        state = await client.state()
        assert state.plan == plan
        assert state.branches["placement"] == "retracted"
        assert all(running.branch != "placement" for running in state.running)
        for command in _plan_of_pose(1):
            await lab.tell("planner", command)
        await until(client, lambda snapshot: snapshot.plan != plan)
        await lab.tell("robot", "execute_motionxx;")
        await until(client, showing(placement="standoff"))
        await lab.tell("robot", "execute_homexxxx;")
        await until(client, showing(placement="retracted"))


@pytest.mark.parametrize(
    "datagram",
    [
        b"",
        b";",
        b"explode_now_xxxx;",
        b"img_fid_numxxxxx;",
        b"img_fid_numxxxxx_06",
        b"img_fid_numxxxxx_06;img_fid_lastrecv;",
        b"img_fid_pntxxxxx_00_nan_0.0_0.0;",
        b"img_fid_pntxxxxx_00_inf_0.0_0.0;",
        b"img_fid_pntxxxxx_00_1_000_0.0_0.0;",
        b"target_tslxxxxxx_0.0_0.0;",
        b"\xff\xfe\xfd;",
        b"start_registrati;" * 40,
    ],
)
async def test_unparsable_datagram_changes_nothing_and_is_not_answered(
    daemon: ServeProcess, client: Client, datagram: bytes
) -> None:
    before = await client.state()
    async with _lab_client(daemon) as lab:
        lab._sender.sendto(datagram, daemon.ready.links["planner"])
        await lab.tell("planner", "tre_stopcalcuxxx;")  # what came before it has been read
        assert lab.quiet()
    assert await client.state() == before


async def test_targets_in_a_row_and_a_moved_head_need_no_other_button(daemon: ServeProcess, client: Client) -> None:
    async with _lab_client(daemon) as lab:
        for command in (*_plan_of_landmarks(), "rob_conn_onxxxxx;", "start_autodigitz;"):
            await lab.tell("robot" if command.startswith("rob") else "planner", command)
        await until(client, showing(digitization="1", placement="retracted"))
        assert 0.1 < float(await lab.ask("planner", "start_registrati;")) < 4.0
        for number, beside in enumerate((0.0, 0.015, 0.030, 0.045)):
            for command in _plan_of_pose(0, beside):
                await lab.tell("planner", command)
            await until(client, showing(toolplan="1", placement="replanned" if number else "retracted"))
            await lab.tell("robot", "execute_motionxx;")
            await until(client, showing(placement="standoff"))
            await lab.tell("robot", "execute_confirmx;")
            await until(client, showing(placement="placed"))
        await client.request_device("scene", "move_body", {"offset_in_tracker": [0.0, 0.004, 0.0]})
        await until(client, showing(alignment="0"))
        before = (await client.state()).sequence
        await lab.tell("robot", "execute_confirmx;")
        await until(client, lambda shown: shown.sequence > before and showing(placement="placed", alignment="1")(shown))
        await lab.tell("robot", "execute_homexxxx;")
        await until(client, showing(placement="retracted"))
