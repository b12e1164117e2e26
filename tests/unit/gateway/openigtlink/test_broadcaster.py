"""Messages to all peers, together or one by one."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from pcmrs.devices.plus.messages import matrix_mm
from tests.support import openigtlink_bytes as wire
from tests.unit.gateway.igtl_client import SEEN, Slicer
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
