"""Poses by the names of PLUS, in mm; what is unknown is left out."""

from __future__ import annotations

import numpy as np

from pcmrs.devices.plus.messages import matrix_mm
from tests.unit.gateway.igtl_client import BODY_REF_FROM_IMAGE, SEEN
from tests.unit.gateway.openigtlink.slicer_room import Room


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
