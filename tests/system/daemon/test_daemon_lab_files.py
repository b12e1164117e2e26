"""What a daemon writes for the lab's modules and scripts, while the lab's client runs a procedure."""

from __future__ import annotations

import asyncio
import csv
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from pcmrs.formats.lab_files import PROCEDURE, LabProcedure, find_lab_files, read_lab_procedure
from pcmrs.spatial import Transform, distance, rotation_angle
from pcmrs.testing.cell import LIGHT
from pcmrs.testing.daemon import free_port
from pcmrs.testing.driving import accept, connect, digitize_landmarks, plan, tool_pose
from tests.system.daemon.daemon_process import PATIENCE, ServeProcess, own_settings, running_daemon


@pytest.fixture
def stream_port() -> int:
    return free_port()


@pytest.fixture
def daemon(tmp_path: Path, stream_port: int) -> Iterator[ServeProcess]:
    settings = [
        *own_settings(tmp_path),
        *LIGHT,
        f"gateway.visualization={{port=0,reply_port={free_port()},stream_port={stream_port}}}",
        f"gateway.lab_files={tmp_path / 'lab'}",
    ]
    with running_daemon(settings, tmp_path) as daemon:
        yield daemon
        assert "Traceback" not in daemon.log


class Stream(asyncio.DatagramProtocol):
    """The port at which the lab's visualization listens."""

    def __init__(self) -> None:
        self.poses: list[Transform] = []

    def datagram_received(self, data: bytes, _: object) -> None:
        numbers = [float(number) for number in data.decode("ascii").removeprefix("__msg_pose_").split("_")]
        self.poses.append(Transform.from_quat_xyzw([value / 1000.0 for value in numbers[:3]], numbers[3:]))


async def _files(folder: Path) -> LabProcedure:
    """The files, once registration and plan are there: the daemon writes beside its loop."""
    async with asyncio.timeout(PATIENCE):
        while True:
            found = read_lab_procedure(find_lab_files(folder, PROCEDURE))
            if found.registration is not None and found.tool_pose is not None:
                return found
            await asyncio.sleep(0.05)


async def _log(folder: Path) -> Path:
    async with asyncio.timeout(PATIENCE):
        while True:
            found = _logs(folder)
            if found:
                return found[0]
            await asyncio.sleep(0.05)


def _logs(folder: Path) -> list[Path]:
    return list(folder.glob("poses_*.csv"))


async def test_files_stream_and_log_agree(daemon: ServeProcess, tmp_path: Path, stream_port: int) -> None:
    loop = asyncio.get_running_loop()
    async with daemon.client() as client:
        await connect(client)
        await digitize_landmarks(client)
        registered = await accept(client, "registration.register")
        await accept(client, "toolplan.plan", **tool_pose())
    files = await _files(tmp_path / "lab")
    assert files.registration is not None
    assert distance(files.registration, Transform.identity()) > 0.05
    mapped = np.array([files.registration @ np.array(point) for point in files.planned])
    fre = np.linalg.norm(mapped - np.array(files.digitized, dtype=float), axis=1)
    assert registered.result is not None
    assert fre.mean() == pytest.approx(registered.result["residual"], rel=1e-6)
    assert files.tool_pose is not None
    assert files.tool_pose.translation.tolist() == pytest.approx(plan().poses[0].position)

    address = ("127.0.0.1", stream_port)
    receiver, stream = await loop.create_datagram_endpoint(Stream, local_addr=address)
    sender, _ = await loop.create_datagram_endpoint(asyncio.DatagramProtocol, local_addr=("127.0.0.1", 0))
    sender.sendto(b"start_visualizex;", daemon.ready.links["visualization"])
    sender.sendto(b"save_continupose;", daemon.ready.links["visualization"])
    rows = list(csv.reader((await _log(tmp_path / "records")).read_text().splitlines()))
    for transport in (receiver, sender):
        transport.close()
    logged = [_pose(values) for name, *values in rows if name == "body_tool"]
    assert len(logged) > 50
    # The arm rests: both are within the tracker's jitter of each other.
    assert distance(logged[0], stream.poses[0]) < 1e-3
    assert rotation_angle(logged[0], stream.poses[0]) < np.radians(1.0)
    for (_, *body_tool), (_, *pol_body), (_, *pol_tool) in zip(rows[::3], rows[1::3], rows[2::3], strict=True):
        assert distance(_pose(pol_body) @ _pose(body_tool), _pose(pol_tool)) < 1e-5


def _pose(values: list[str]) -> Transform:
    numbers = [float(value) for value in values]
    return Transform.from_quat_xyzw(numbers[:3], numbers[3:])
