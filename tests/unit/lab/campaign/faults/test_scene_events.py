"""What a subscriber has seen of a fault of the scene is its evidence, and there is none without the fault."""

from __future__ import annotations

import asyncio
from typing import Any, cast

import pytest

from pcmrs.messages import SceneEvent
from pcmrs.testing.errors import Unmet
from pcmrs_lab.campaign.faults.scene_events import FLOOD, _danger, _flood, _seen
from pcmrs_lab.experiment.scene_camera import SceneCamera


def event(label: str, reason: str = "") -> SceneEvent:
    return SceneEvent(source="camera", label=label, captured=1.0, sent=1.0, session="s", reason=reason)


async def test_other_events_are_the_evidence() -> None:
    camera, began = SceneCamera(cast(Any, None)), asyncio.get_running_loop().time()
    for each in (event("watching"), event("intrusion"), event("blind", "occluded")):
        camera.take("scene/local", each)
    assert _seen(camera, began) == {"other events": ["intrusion", "occluded"]}


async def test_without_events_the_silence_is_the_evidence() -> None:
    camera, began = SceneCamera(cast(Any, None)), asyncio.get_running_loop().time()
    camera.events = [(began + 0.1, event("watching"))]
    (gap,) = _seen(camera, began - 2.0).values()
    assert gap == pytest.approx(2.1)


def test_journal_without_the_danger_is_named() -> None:
    class Cell:
        def rows(self, _after: int) -> list[Any]:
            return []

    with pytest.raises(Unmet, match="has no scene_lost"):
        _danger(cast(Any, Cell()), 3, "scene_lost")


async def test_flood_is_of_the_present_session() -> None:
    class Bus:
        def __init__(self) -> None:
            self.sent: list[tuple[str, SceneEvent]] = []

        def publish(self, key: str, message: SceneEvent) -> None:
            self.sent.append((key, message))

    class Cell:
        bus = Bus()

    camera = SceneCamera(cast(Any, None))
    camera.take("scene/local", event("watching"))
    _flood(cast(Any, Cell()), camera)
    assert len(Cell.bus.sent) == FLOOD
    assert {(key, each.session) for key, each in Cell.bus.sent} == {("scene/local", "s")}
