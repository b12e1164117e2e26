"""A motion of the arm in the world's process, and the wait for what it shows."""

from __future__ import annotations

import asyncio
from collections.abc import Callable

import numpy as np

from pcmrs.clock import SystemClock
from pcmrs.kinematics.arms import ARMS
from pcmrs.messages import JointTrajectory

HOME = np.array(ARMS["iiwa14"].home)
CLOCK = SystemClock()
PATIENCE = 60.0


def motion(seconds: float) -> JointTrajectory:
    way = (1 - np.cos(np.linspace(0.0, np.pi, 200))) / 2
    return JointTrajectory(period=seconds / 199, positions=(HOME + way[:, None] * 0.5).tolist())


async def until(condition: Callable[[], bool]) -> None:
    async with asyncio.timeout(PATIENCE):
        while not condition():  # noqa: ASYNC110
            await asyncio.sleep(0.01)
