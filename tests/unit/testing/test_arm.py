"""An arm that moves is found out, whatever is said of it; one that stands is not."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from types import SimpleNamespace
from typing import Any, cast

import pytest

from pcmrs.messages import JointState
from pcmrs.testing.arm import BRAKING, LOOK, NO_MOTION, STANDS_WITHIN, displaced, standing, stands, unmoved
from pcmrs.testing.cell import RunningCell
from pcmrs.testing.errors import Unmet
from pcmrs.testing.loop import run_on_simulated_loop

Place = tuple[float, float, float]
PERIOD = 0.05
"""Time between two messages of the joints, s."""


class ArmCell:
    """A cell whose tool is at given places, one after the other, and whose first joint moves at a given speed.

    Attributes:
        asked: Times at which the tool was looked at, s of the loop.
    """

    def __init__(self, *places: Place, speed: float | None = 0.0) -> None:
        self.asked: list[float] = []
        self._places = list(places)
        self._speed = speed
        self.client = self.scene = self

    @property
    def as_cell(self) -> RunningCell:
        return cast(RunningCell, self)

    async def truth(self) -> Any:
        self.asked.append(asyncio.get_running_loop().time())
        return SimpleNamespace(tracker_from_coil=SimpleNamespace(position=self._places.pop(0)))

    def listen(self, key: str, kind: type, handler: Callable[[JointState], None]) -> Callable[[], Awaitable[None]]:
        assert (key, kind) == ("state/joints", JointState)
        publishing = asyncio.get_running_loop().create_task(self._publish(handler))

        async def end() -> None:
            publishing.cancel()

        return end

    async def _publish(self, handler: Callable[[JointState], None]) -> None:
        while self._speed is not None:
            now = asyncio.get_running_loop().time()
            position = self._speed * now
            handler(
                JointState(
                    captured=now,
                    sent=now,
                    positions=[position, 0.0],
                    velocities=[self._speed, 0.0],
                    torques=[0.0, 0.0],
                    moving=False,
                )
            )
            await asyncio.sleep(PERIOD)


@pytest.mark.parametrize("way", [0.0, STANDS_WITHIN / 2])
def test_an_arm_that_stays_where_it_was_is_unmoved(way: float) -> None:
    async def look() -> None:
        async with unmoved(ArmCell((0.1, 0.2, 0.3), (0.1 + way, 0.2, 0.3)).as_cell):
            pass

    run_on_simulated_loop(look())


def test_an_arm_that_went_anywhere_is_not() -> None:
    async def look() -> None:
        async with unmoved(ArmCell((0.1, 0.2, 0.3), (0.1, 0.201, 0.3)).as_cell):
            pass

    with pytest.raises(Unmet, match=r"moved by 1\.00 mm"):
        run_on_simulated_loop(look())


def test_an_arm_is_watched_once_its_brakes_have_closed() -> None:
    cell = ArmCell((0.0, 0.0, 0.1), (0.0, 0.0, 0.1 + STANDS_WITHIN / 2))
    assert run_on_simulated_loop(stands(cell.as_cell)) == pytest.approx(STANDS_WITHIN / 2)
    assert cell.asked == [BRAKING, BRAKING + LOOK]
    with pytest.raises(Unmet, match=r"moved by 100\.00 mm"):
        run_on_simulated_loop(stands(ArmCell((0.0, 0.0, 0.1), (0.0, 0.0, 0.2)).as_cell))


async def watch(speed: float | None) -> list[float]:
    async with standing(ArmCell(speed=speed).as_cell) as moved:
        pass
    return moved


@pytest.mark.parametrize(("speed", "text"), [(0.2, "A joint moved by"), (None, "not published")])
def test_a_joint_that_moves_or_is_silent_does_not_stand(speed: float | None, text: str) -> None:
    with pytest.raises(Unmet, match=text):
        run_on_simulated_loop(watch(speed))


def test_joints_that_rest_stand() -> None:
    assert run_on_simulated_loop(watch(0.0)) == [0.0]


def test_the_way_of_a_joint_is_measured_until_it_has_braked() -> None:
    async def measure() -> float:
        async with displaced(ArmCell(speed=0.1).as_cell) as moved:
            await asyncio.sleep(1.0)
        return moved[0]

    assert run_on_simulated_loop(measure()) == pytest.approx(0.1 * (1.0 + BRAKING), abs=0.1 * PERIOD + NO_MOTION)
