from __future__ import annotations

import asyncio
import json
import math
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

from pcmrs.clock import SystemClock
from pcmrs.devices.plus.messages import matrix_mm
from pcmrs.errors import ConfigurationError
from pcmrs.gateway.links import Gateway, open_gateway
from pcmrs.gateway.openigtlink import link
from pcmrs.gateway.settings import GatewayConfig, LinkConfig, OpenIgtLinkConfig
from pcmrs.messages import Command, Running, Verdict
from tests.support import openigtlink_bytes as wire
from tests.unit.gateway.gateway_fakes import WITHIN, UdpClient
from tests.unit.gateway.igtl_client import BODY_REF_FROM_IMAGE, SEEN, Slicer, SlicerCore, planned_mm, slicer_only

TARGET = "ToolTargetToImage"
LANDMARKS_MM = [(80.0, 10.0, 0.0), (-80.0, 10.0, 0.0), (0.0, 95.5, -20.0)]
LINE = "registration 000, digitization 0, toolplan 0, robot 1, placement retracted"
FACES = ["left", "", "nasion"]


@dataclass
class Room:
    """A gateway with an OpenIGTLink server and a robot link, before a fake daemon, and a Slicer."""

    core: SlicerCore
    gateway: Gateway
    slicer: Slicer

    @property
    def address(self) -> tuple[str, int]:
        return self.gateway.addresses["openigtlink"]


def config(**values: Any) -> GatewayConfig:
    table = msgspec.convert({"enabled": True, "port": 0, "rate_hz": 200.0} | values, OpenIgtLinkConfig)
    return slicer_only(table, robot=LinkConfig(port=0))


@asynccontextmanager
async def opened(folder: Path, **values: Any) -> AsyncIterator[Room]:
    core = SlicerCore()
    async with open_gateway(core, config(**values), SystemClock(), folder) as gateway:
        room = Room(core, gateway, await Slicer.connect(gateway.addresses["openigtlink"]))
        yield room
        room.slicer.close()
        core.open_gates()


@pytest.fixture
async def room(tmp_path: Path) -> AsyncIterator[Room]:
    async with opened(tmp_path) as made:
        yield made


async def test_poses_are_sent_in_mm_by_the_names_of_plus(room: Room) -> None:
    image_from_tracker = (SEEN["body_ref"] @ BODY_REF_FROM_IMAGE).inverse()
    expected = {
        "CoilToTracker": SEEN["coil"],
        "PointerToTracker": SEEN["pointer"],
        "ReferenceToTracker": SEEN["body_ref"],
        "CoilToImage": image_from_tracker @ SEEN["coil"],
        "PointerToImage": image_from_tracker @ SEEN["pointer"],
        "ReferenceToImage": BODY_REF_FROM_IMAGE.inverse(),
        "TargetToImage": room.core.target,
        "FlangeToBase": room.core.pose,
    }
    for name, pose in expected.items():
        assert pose is not None
        message = await room.slicer.next(name)
        assert message.message_type == "TRANSFORM"
        np.testing.assert_allclose(message.matrix, matrix_mm(pose), atol=1e-3)
    tip = await room.slicer.next("PointerTipToImage")
    np.testing.assert_allclose(tip.matrix[:3, 3], [100.0, 200.0, 300.0])


async def test_sent_messages_are_openigtlink_byte_by_byte(room: Room) -> None:
    assert room.core.target is not None
    expected, found = matrix_mm(room.core.target), dict[str, bytes]()
    while {"TargetToImage", "PcmrsLine", "PcmrsStatus"} - set(found):
        header = await room.slicer.stream.readexactly(58)
        version, _, name, *_, size, _ = wire.HEADER.unpack(header)
        found[name.rstrip(b"\0").decode()] = header + await room.slicer.stream.readexactly(size)
        assert version == 1
    for data in found.values():  # the stamp is the only thing that the oracle cannot know
        assert wire.HEADER.unpack(data[:58])[6] == wire.crc64(data[58:])
    for name, oracle in (
        ("TargetToImage", wire.transform("TargetToImage", expected)),
        ("PcmrsStatus", wire.status("PcmrsStatus", 1, "", "")),
        (
            "PcmrsLine",
            wire.string("PcmrsLine", "registration 000, digitization 0, toolplan 0, robot 1, placement retracted"),
        ),
    ):
        assert found[name][:34] == oracle[:34]
        assert found[name][42:] == oracle[42:]


async def test_unseen_body_is_not_sent(room: Room) -> None:
    room.core.bodies, room.core.target, room.core.pose = {"coil": SEEN["coil"]}, None, None
    await room.slicer.status(1)  # from before or after the change
    await room.slicer.names(60)
    assert await room.slicer.names(60) <= {"CoilToTracker", "PcmrsStatus"}


async def test_without_a_registration_nothing_is_sent_in_the_image(room: Room) -> None:
    room.core.registered = room.core.target = None
    await room.slicer.names(60)
    names = await room.slicer.names(60)
    assert "ReferenceToTracker" in names
    assert not [name for name in names if name.endswith("ToImage")]


async def test_poses_may_go_together(tmp_path: Path) -> None:
    async with opened(tmp_path, poses="TDATA") as room:
        message = await room.slicer.next("PcmrsTools")
        assert message.message_type == "TDATA"
        assert {"CoilToTracker", "CoilToImage", "TargetToImage", "FlangeToBase"} < set(message.matrices)
        np.testing.assert_allclose(message.matrices["CoilToTracker"], matrix_mm(SEEN["coil"]), atol=1e-3)


async def test_state_is_sent_to_a_new_client_and_at_each_change(room: Room) -> None:
    first = json.loads((await room.slicer.next("PcmrsState")).string)
    assert first["branches"] == room.core.branches
    assert (first["latched"], first["running"]) == (False, [])
    room.core.branches["placement"] = "standoff"
    room.core.running = [Running(branch="placement", operation="approach", id="1")]
    room.core.latched = True
    second = json.loads((await room.slicer.next("PcmrsState")).string)
    assert (second["branches"]["placement"], second["running"]) == ("standoff", ["placement.approach"])
    await room.slicer.next("PcmrsLine")
    line = (await room.slicer.next("PcmrsLine")).string
    assert line.startswith("LATCHED, registration 000")
    assert line.endswith("placement standoff, running placement.approach")
    assert (await room.slicer.status(3)).error_name == "latched"
    room.core.latched = False
    await room.slicer.status(1)


async def test_change_before_another_client_comes_reaches_the_first(tmp_path: Path) -> None:
    async with opened(tmp_path, rate_hz=20.0) as room:
        await room.slicer.next("TargetToImage")  # the first tick is over
        first = await room.slicer.next("PcmrsLine")
        room.core.branches["placement"] = "standoff"
        second = await Slicer.connect(room.address)
        assert (await second.next("PcmrsLine")).string.endswith("standoff")
        while (line := await room.slicer.next("PcmrsLine")).string == first.string:
            pass
        assert line.string.endswith("standoff")
        second.close()


async def test_a_target_is_planned_in_metres(room: Room) -> None:
    room.slicer.send(wire.transform(TARGET, planned_mm()))
    assert await room.slicer.verdict() == "accepted toolplan.plan"
    (command,) = room.core.commands
    assert (command.branch, command.operation) == ("toolplan", "plan")
    assert command.source.startswith("openigtlink:127.0.0.1:")
    assert command.arguments["position"] == pytest.approx([0.04, 0.06, 0.08])
    assert command.arguments["quat_xyzw"] == pytest.approx([0.0, 0.0, math.sqrt(0.5), math.sqrt(0.5)])


async def test_a_header_of_version_2_is_taken_too(room: Room) -> None:
    data = wire.with_metadata("TRANSFORM", TARGET, wire.matrix_bytes(planned_mm()), {"TransformStatus": "OK"})
    room.slicer.send(data)
    assert await room.slicer.verdict() == "accepted toolplan.plan"


async def test_landmarks_are_planned_in_metres(room: Room) -> None:
    room.slicer.send(wire.points("Landmarks", LANDMARKS_MM, FACES))
    assert await room.slicer.verdict() == "accepted registration.plan_landmarks"
    (command,) = room.core.commands
    found = command.arguments["landmarks"]
    assert [landmark["name"] for landmark in found] == ["left", "p1", "nasion"]
    np.testing.assert_allclose([landmark["position"] for landmark in found], np.array(LANDMARKS_MM) * 1e-3)


async def test_plan_that_slicer_resends_is_submitted_once(room: Room) -> None:
    data = wire.transform(TARGET, planned_mm()) + wire.points("Landmarks", LANDMARKS_MM, FACES)
    for sent in range(1, 6):
        room.slicer.send(data)
        while room.gateway.counters.received < 2 * sent or len(room.core.commands) < 2:
            await room.slicer.next("CoilToImage")
    room.slicer.send(wire.transform(TARGET, planned_mm((41.0, 60.0, 80.0))))
    while len(room.core.commands) < 3:
        await room.slicer.next("CoilToImage")
    assert room.core.operations == ["plan", "plan_landmarks", "plan"]
    assert room.core.commands[-1].arguments["position"][0] == pytest.approx(0.041)


async def test_while_a_plan_is_decided_only_the_newest_waits(room: Room) -> None:
    room.core.gates["plan"].clear()
    room.slicer.send(wire.transform(TARGET, planned_mm((9.0, 60.0, 80.0))))
    async with asyncio.timeout(WITHIN):
        await room.core.arrived.wait()
    for x in range(30):
        room.slicer.send(wire.transform(TARGET, planned_mm((10.0 + x, 60.0, 80.0))))
    room.slicer.send(wire.points("Landmarks", LANDMARKS_MM, FACES))
    while room.gateway.counters.received < 32:
        await room.slicer.next("CoilToImage")
    room.core.gates["plan"].set()
    assert [await room.slicer.verdict() for _ in range(3)] == [
        "accepted toolplan.plan",
        "accepted toolplan.plan",
        "accepted registration.plan_landmarks",
    ]
    first, newest, _ = room.core.commands
    assert first.arguments["position"][0] == pytest.approx(0.009)
    assert newest.arguments["position"][0] == pytest.approx(0.039)


BAD_TARGETS = {
    "identity": (np.eye(4), "wrong_unit"),
    "metres": (planned_mm((0.04, 0.06, 0.08)), "wrong_unit"),
    "far": (planned_mm((40.0, 1000.5, 80.0)), "wrong_unit"),
    "nan": (planned_mm((math.nan, 0.0, 0.0)), "not_finite"),
    "scaled": (planned_mm() @ np.diag([1.01, 1.01, 1.01, 1.0]), "not_rigid"),
    "mirrored": (planned_mm() @ np.diag([-1.0, 1.0, 1.0, 1.0]), "mirrored"),
}


@pytest.mark.parametrize("bad", BAD_TARGETS)
async def test_invalid_target_is_refused_with_the_reason(room: Room, bad: str) -> None:
    matrix, code = BAD_TARGETS[bad]
    room.slicer.send(wire.transform(TARGET, matrix))
    assert (await room.slicer.verdict()).startswith(f"rejected toolplan.plan {code}: ")
    status = await room.slicer.status(2)
    assert status.error_name == code
    assert status.text
    assert room.core.commands == []


@pytest.mark.parametrize(
    ("positions", "code"),
    [
        (LANDMARKS_MM[:2], "wrong_count"),
        ([(float(x), 0.0, 0.0) for x in range(101)], "wrong_count"),
        ([(0.08, 0.01, 0.0), (-0.08, 0.01, 0.0), (0.0, 0.0955, -0.02)], "wrong_unit"),
        ([*LANDMARKS_MM, (0.0, 2000.0, 0.0)], "wrong_unit"),
        ([*LANDMARKS_MM, (0.0, math.inf, 0.0)], "not_finite"),
    ],
)
async def test_invalid_landmarks_are_refused(room: Room, positions: Any, code: str) -> None:
    room.slicer.send(wire.points("Landmarks", positions, [""] * len(positions)))
    assert (await room.slicer.verdict()).startswith(f"rejected registration.plan_landmarks {code}: ")
    assert room.core.commands == []
    assert [event.fields["reason"] for event in room.core.events] == [code]


async def test_rejected_plan_is_shown_until_one_is_accepted(room: Room) -> None:
    room.core.refusals["plan"] = "busy"
    room.slicer.send(wire.transform(TARGET, planned_mm()))
    assert (await room.slicer.verdict()).startswith("rejected toolplan.plan busy")
    assert (await room.slicer.status(2)).error_name == "busy"
    room.core.refusals.clear()
    room.slicer.send(wire.transform(TARGET, planned_mm((41.0, 60.0, 80.0))))
    assert await room.slicer.verdict() == "accepted toolplan.plan"
    await room.slicer.status(1)


@pytest.mark.parametrize("by_daemon", [True, False])
async def test_a_refused_plan_holds_the_motions_of_its_host_back(room: Room, by_daemon: bool) -> None:
    panel, robot = await UdpClient.open(), room.gateway.addresses["robot"]
    assert (await panel.ask("execute_motionxx_#1;", robot)).startswith("1_accepted")
    if by_daemon:
        room.core.refusals["plan"] = "unreachable"
    room.slicer.send(wire.transform(TARGET, planned_mm((41.0, 60.0, 80.0)) if by_daemon else np.eye(4)))
    assert (await room.slicer.verdict()).startswith("rejected")
    room.core.refusals.clear()
    assert (await panel.ask("execute_motionxx_#2;", robot)).endswith("plan_not_accepted;")
    room.slicer.send(wire.transform(TARGET, planned_mm()))
    assert (await room.slicer.verdict()).startswith("accepted")
    assert (await panel.ask("execute_motionxx_#3;", robot)).startswith("3_accepted")
    panel.transport.close()


async def test_stop_passes_a_plan_under_way_and_rejects_what_waits(room: Room) -> None:
    room.core.gates["plan"].clear()
    room.slicer.send(wire.transform(TARGET, planned_mm()))
    async with asyncio.timeout(WITHIN):
        await room.core.arrived.wait()
    room.slicer.send(wire.points("Landmarks", LANDMARKS_MM, FACES) + wire.string("Anything", " Stop\n"))
    assert (await room.slicer.verdict()).startswith("rejected registration.plan_landmarks stopped")
    assert await room.slicer.verdict() == "accepted stop"
    assert len(room.core.stops) == 1
    room.core.gates["plan"].set()
    assert await room.slicer.verdict() == "accepted toolplan.plan"  # the one under way is the daemon's to end
    room.slicer.send(wire.transform(TARGET, planned_mm((41.0, 60.0, 80.0))))
    assert await room.slicer.verdict() == "accepted toolplan.plan"
    assert room.core.operations == ["plan", "plan"]


async def test_a_stop_that_is_not_confirmed_is_no_success(room: Room) -> None:
    room.core.stands = False
    room.slicer.send(wire.string("S", "stop"))
    assert (await room.slicer.verdict()).startswith("failed stop hold_not_confirmed")


async def test_a_daemon_that_breaks_is_answered_for(room: Room, monkeypatch: pytest.MonkeyPatch) -> None:
    async def broken(command: object) -> None:
        raise OSError("disk full")

    monkeypatch.setattr(room.core, "submit", broken)
    room.slicer.send(wire.transform(TARGET, planned_mm()))
    assert (await room.slicer.verdict()).startswith("failed toolplan.plan internal_error")


async def test_plan_that_is_not_accepted_without_a_reason_is_answered(
    room: Room, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def undecided(command: Command) -> Verdict:
        return Verdict(id=command.id, branch="toolplan", operation="plan", decision="unknown", state="0", sequence=1)

    monkeypatch.setattr(room.core, "submit", undecided)
    room.slicer.send(wire.transform(TARGET, planned_mm()))
    assert (await room.slicer.verdict()).startswith("unknown toolplan.plan unknown")
    assert (await room.slicer.status(2)).error_name == "unknown"


async def test_other_messages_change_nothing_and_are_not_answered(room: Room) -> None:
    for data in (
        wire.string("PcmrsVerdict", "accepted stop"),  # Slicer may send back what it got
        wire.string("S", "move"),
        wire.transform("CoilToImage", planned_mm()),
        wire.points("F", LANDMARKS_MM, FACES),
        wire.message("IMAGE", TARGET, b"x" * 100_000),
        wire.message("GET_STATUS", "", b""),
    ):
        room.slicer.send(data)
    room.slicer.send(wire.string("S", "stop"))
    assert await room.slicer.verdict() == "accepted stop"
    assert room.core.commands == []
    assert room.gateway.counters.refused == 0


async def test_a_damaged_message_is_counted_and_changes_nothing(room: Room) -> None:
    damaged = bytearray(wire.transform(TARGET, planned_mm()))
    damaged[-1] ^= 1
    room.slicer.send(bytes(damaged) + wire.transform(TARGET, planned_mm((50.0, 0.0, 0.0))))
    assert await room.slicer.verdict() == "accepted toolplan.plan"
    assert room.gateway.counters.refused == 1
    assert len(room.core.commands) == 1


async def test_data_that_is_no_openigtlink_ends_only_its_connection(room: Room) -> None:
    stranger = await Slicer.connect(room.address)
    stranger.send(b"GET / HTTP/1.1\r\n" + b"x" * 100)
    with pytest.raises((asyncio.IncompleteReadError, ConnectionError)):
        await stranger.next("nothing")
    stranger.close()
    assert room.gateway.counters.refused == 1
    room.slicer.send(wire.transform(TARGET, planned_mm()))
    assert await room.slicer.verdict() == "accepted toolplan.plan"


async def test_client_may_leave_in_mid_message_and_come_back(room: Room) -> None:
    room.slicer.send(wire.transform(TARGET, planned_mm())[:70])
    room.slicer.close()
    again = await Slicer.connect(room.address)
    again.send(wire.transform(TARGET, planned_mm()))
    assert await again.verdict() == "accepted toolplan.plan"
    assert len(room.core.commands) == 1
    again.close()


async def test_no_more_clients_than_so_many(room: Room, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(link, "MAX_PEERS", 1)
    await room.slicer.next("PcmrsState")
    second = await Slicer.connect(room.address)
    with pytest.raises((asyncio.IncompleteReadError, ConnectionError)):
        await second.next("PcmrsState")
    second.close()
    assert room.gateway.counters.refused == 1


async def test_link_off_loopback_shows_but_takes_no_commands(tmp_path: Path) -> None:
    core = SlicerCore()
    exposed = slicer_only(OpenIgtLinkConfig(enabled=True, port=0), host="0.0.0.0")
    async with open_gateway(core, exposed, SystemClock(), tmp_path) as gateway:
        slicer = await Slicer.connect(("127.0.0.1", gateway.addresses["openigtlink"][1]))
        slicer.send(wire.transform(TARGET, planned_mm()) + wire.string("S", "stop"))
        async with asyncio.timeout(WITHIN):
            await slicer.next("CoilToImage")
            while gateway.counters.refused < 2:
                await slicer.next("CoilToImage")
        slicer.close()
    assert (core.commands, core.stops) == ([], [])


async def test_port_in_use_is_an_error(room: Room, tmp_path: Path) -> None:
    with pytest.raises(ConfigurationError, match=r"OpenIGTLink port .* cannot be bound"):
        async with opened(tmp_path, port=room.address[1]):
            pass


async def test_it_is_off_unless_asked_for(tmp_path: Path) -> None:
    off = slicer_only(OpenIgtLinkConfig())
    async with open_gateway(SlicerCore(), off, SystemClock(), tmp_path) as gateway:
        assert gateway.addresses == {}


@pytest.mark.parametrize(
    "values",
    [
        {"role": "client", "port": 0},
        {"rate_hz": 0.0},
        {"rate_hz": math.nan},
        {"target": ""},
        {"target": "TargetToImage"},
        {"landmarks": "x" * 21},
    ],
)
def test_the_table_is_checked(values: dict[str, Any]) -> None:
    with pytest.raises(ConfigurationError, match="openigtlink"):
        msgspec.convert(values, OpenIgtLinkConfig)
