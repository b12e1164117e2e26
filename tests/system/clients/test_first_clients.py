"""The clients of the first released version, as they were, against the gateway and the bus of this version.

``first_clients.tar.gz`` has their files of commit 3aa46ff: labs copy clients, and do not update them with the daemon.
"""

from __future__ import annotations

import asyncio
import importlib.util
import itertools
import json
import sys
import tarfile
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

import msgspec
import pytest

from pcmrs.bus.codec import unpack
from pcmrs.bus.commands import Envelope
from pcmrs.bus.keys import split_command_key
from pcmrs.gateway.commands import COMMANDS
from pcmrs.gateway.grammar import parse
from pcmrs.messages import Verdict
from tests.system.clients.unity_programs import NEEDS_MONO, cell_probe, compile_client
from tests.unit.gateway.gateway_fakes import CONFIRMED, WITHIN
from tests.unit.gateway.signed_room import Room, open_room, peer

ARCHIVE = Path(__file__).with_name("first_clients.tar.gz")
POINTS = [(4.0, 86.0, 39.9), (4.0, 103.5, -7.8), (-45.6, 69.1, 35.0)]
"""Landmarks in the image, mm."""
EVERY_BUTTON = {
    "Connect robot": ["robot.connect"],
    "Digitize all": ["digitization.digitize_all"],
    "Register": ["registration.register"],
    "Previous registration": ["registration.use_previous"],
    "Approach": ["placement.approach"],
    "Confirm": ["placement.confirm"],
    "Back off": ["placement.back_off"],
    "Home": ["placement.home"],
    "Start anew": ["registration.reinit", "toolplan.reinit"],
    "Disconnect robot": ["robot.disconnect"],
}


@pytest.fixture(scope="session")
def first_clients(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of the clients of the first version."""
    folder = tmp_path_factory.mktemp("first")
    with tarfile.open(ARCHIVE) as archive:
        archive.extractall(folder, filter="data")
    return folder / "clients"


def imported(file: Path, name: str) -> Any:
    """Import a client under a name that the present one does not have."""
    places = [str(file.parent)] if file.name == "__init__.py" else None
    spec = importlib.util.spec_from_file_location(name, file, submodule_search_locations=places)
    assert spec is not None
    assert spec.loader is not None
    module: ModuleType = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="session")
def slicer(first_clients: Path) -> Any:
    """Core of the module for 3D Slicer."""
    return imported(first_clients / "slicer" / "PcmrsPlanner" / "pcmrs_link" / "__init__.py", "first_pcmrs_link")


@pytest.fixture(scope="session")
def python_signer(first_clients: Path) -> Any:
    """Signer for programs in Python."""
    return imported(first_clients / "python" / "pcmrs_signer.py", "first_pcmrs_signer")


def operations(room: Room) -> list[str]:
    return [f"{command.branch}.{command.operation}" for command in room.core.commands]


async def test_every_button_of_the_first_slicer_module_works(slicer: Any, tmp_path: Path) -> None:
    async with open_room(tmp_path, {"planner": peer(tmp_path, "planner")}) as room:
        room.core.results |= {"register": {"residual": 0.0012}, "confirm": CONFIRMED}
        signer = slicer.Signer("planner", slicer.read_key(str(tmp_path / "planner.key")))
        link = slicer.Link(port=room.planner[1], pose_port=None, point_port=None, signer=signer)
        planner = slicer.Planner(link)

        async def ended(begin: Callable[[Callable[[Any], None]], None]) -> Any:
            verdicts: list[Any] = []
            begin(verdicts.append)
            async with asyncio.timeout(WITHIN):
                while not verdicts:
                    link.tick()
                    await asyncio.sleep(0.001)
            return verdicts[0]

        planned = await ended(lambda then: planner.plan_landmarks(POINTS, then))
        assert (planned.accepted, planned.branch, planned.state) == (True, "registration", "000")
        landmarks = room.core.commands[-1].arguments["landmarks"]
        assert [point["position"] for point in landmarks] == [
            pytest.approx([value / 1000.0 for value in point]) for point in POINTS
        ]
        tool = slicer.Pose((4.0, -12.0, 143.0), (0.0, 0.0, 0.0, 1.0))
        assert (await ended(lambda then: planner.plan_tool(tool, then))).accepted
        for title, wanted in EVERY_BUTTON.items():
            before = len(room.core.commands)
            verdict = await ended(lambda then, title=title: planner.act(title, then))  # type: ignore[misc]
            assert verdict.accepted, (title, verdict)
            assert operations(room)[before:] == wanted
        assert planner.residual == pytest.approx(1.2)
        assert planner.placement is not None
        assert planner.placement.translation_error == pytest.approx(0.25)
        stopped = await ended(planner.stop)
        assert stopped.accepted
        assert len(room.core.stops) == 1
        room.core.refusals["approach"] = "invalid_in_state"
        assert (await ended(lambda then: planner.plan_tool(tool, then))).accepted
        refused = await ended(lambda then: planner.act("Approach", then))
        assert (refused.decision, refused.reason) == ("rejected", "invalid_in_state")
        link.close()


async def test_frames_of_the_first_python_signer_are_accepted(python_signer: Any, tmp_path: Path) -> None:
    """Over UDP, and over TCP after its opening."""
    async with open_room(tmp_path, {"planner": peer(tmp_path, "planner")}) as room:
        signer = python_signer.Signer("planner", python_signer.read_key(str(tmp_path / "planner.key")))
        room.client.send(signer.sign(b"rob_conn_onxxxxx_#1;"), room.planner)
        assert (await room.client.received.get()).startswith("1_accepted_robot_1")
        reader, writer = await asyncio.open_connection(*room.tcp)
        writer.write(python_signer.OPENING + signer.frame(b"session_reinitxx_#2;"))
        async with asyncio.timeout(WITHIN):
            answer = await reader.readuntil(b";")
        writer.close()
        assert answer.startswith(b"2_accepted_")
    assert operations(room) == ["robot.connect", "registration.reinit", "toolplan.reinit"]


def test_every_string_command_of_the_first_version_is_known(slicer: Any) -> None:
    """Bytes as the first version's table, client and tests have them."""
    kept = json.loads(Path(__file__).with_name("first_commands.json").read_text())
    assert {datagram[:16] for datagram in kept} <= set(COMMANDS)
    for datagram, values in kept.items():
        request = parse(datagram.encode("ascii"))
        assert [request.spec.name, list(request.values), request.id] == [datagram[:16], values, "7"]


@NEEDS_MONO
@pytest.mark.timeout(300)
async def test_the_first_unity_client_works(first_clients: Path, tmp_path: Path) -> None:
    programs = tmp_path / "programs"
    programs.mkdir()
    await asyncio.to_thread(compile_client, programs, first_clients / "unity")
    async with open_room(tmp_path, {"planner": peer(tmp_path, "planner")}) as room:
        room.core.results |= {"register": {"residual": 0.0012}, "confirm": CONFIRMED}
        key = str(tmp_path / "planner.key")
        async with cell_probe(programs, room.planner[1], "planner", key) as probe:
            await probe.demand("connect")
            await probe.demand("plan_landmarks", *itertools.chain(*POINTS))
            await probe.demand("digitize_all")
            assert await probe.demand("register") == [pytest.approx(1.2)]
            await probe.demand("plan_pose", 0.004, 0.143, -0.012, 0.0, 0.0, 0.0, 1.0)
            await probe.demand("approach")
            assert (await probe.demand("confirm"))[7:] == [pytest.approx(0.25), pytest.approx(0.0573, abs=1e-3)]
            await probe.demand("home")
            await probe.demand("stop")
    assert operations(room) == [
        "robot.connect", "registration.plan_landmarks", "digitization.digitize_all", "registration.register",
        "toolplan.plan", "placement.approach", "placement.confirm", "placement.home",
    ]  # fmt: skip
    assert len(room.core.stops) == 1


def test_the_first_python_client_on_the_bus_is_understood() -> None:
    """Key and payload as the first version's `Client.call` sends them, and the answer as it reads them."""
    key = "cmd/local/toolplan/plan"
    payload = bytes.fromhex(
        "84a26964d9203666316564303032616235353935383539303134656266303935313532326439a473"
        "656e74cb41dac0ffc0100000a374746ccb4014000000000000a9617267756d656e747382a8706f73"
        "6974696f6e93cb3f70624dd2f1a9fccbbf889374bc6a7efacb3fc24dd2f1a9fbe7a9717561745f78"
        "797a7794cb0000000000000000cb0000000000000000cb0000000000000000cb3ff0000000000000"
    )
    envelope = unpack(payload, Envelope)
    assert split_command_key(key) == ("local", "toolplan", "plan")
    assert envelope.arguments == {"position": [0.004, -0.012, 0.143], "quat_xyzw": [0.0, 0.0, 0.0, 1.0]}
    assert (envelope.id, envelope.ttl) == ("6f1ed002ab5595859014ebf0951522d9", 5.0)
    answer = Verdict(id="c", branch="toolplan", operation="plan", decision="accepted", state="1", sequence=4)
    read = json.loads(msgspec.json.encode(answer))
    required = {"id", "branch", "operation", "decision", "state", "sequence"}
    assert required <= read.keys() <= required | {"reason", "result", "allowed"}
