"""Frames of the simulated tracker, as these tests read them."""

from collections.abc import Mapping, Sequence
from contextlib import aclosing
from typing import Any

import numpy as np

from pcmrs.kinematics.arms import ARMS
from pcmrs.messages import BodyPose, PoseMessage
from pcmrs.spatial import Transform

Devices = Mapping[str, Any]
HOME = np.array(ARMS["iiwa14"].home)


def transform(pose: PoseMessage | BodyPose) -> Transform:
    return Transform.from_quat_wxyz(pose.position, pose.quat_wxyz)


async def next_frames(devices: Mapping[str, Any], count: int) -> list[Sequence[BodyPose]]:
    frames = []
    async with aclosing(devices["tracker"].frames()) as coming:
        async for frame in coming:
            frames.append(frame)
            if len(frames) == count:
                break
    return frames
