"""Messages to all peers: poses by the names of PLUS, in mm, together or one by one; the state at each change."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from pcmrs.devices.plus.messages import matrix_mm
from pcmrs.messages import Running
from tests.support import openigtlink_bytes as wire
from tests.unit.gateway.igtl_client import BODY_REF_FROM_IMAGE, SEEN, Slicer
from tests.unit.gateway.openigtlink.slicer_room import Room, opened


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


async def test_poses_may_go_together(tmp_path: Path) -> None:
    async with opened(tmp_path, poses="TDATA") as room:
        message = await room.slicer.next("PcmrsTools")
        assert message.message_type == "TDATA"
        assert {"CoilToTracker", "CoilToImage", "TargetToImage", "FlangeToBase"} < set(message.matrices)
        np.testing.assert_allclose(message.matrices["CoilToTracker"], matrix_mm(SEEN["coil"]), atol=1e-3)


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
