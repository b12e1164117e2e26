"""The detector beside a cell is waited for, and what it has published is counted."""

from __future__ import annotations

import asyncio
from types import SimpleNamespace
from typing import Any, cast

import pytest

from pcmrs.messages import SceneEvent
from pcmrs.testing.errors import Unmet
from pcmrs_lab.experiment.scene_camera import SceneCamera


class Input:
    """Standard input of a process."""

    def __init__(self) -> None:
        self.lines: list[bytes] = []

    def write(self, line: bytes) -> None:
        self.lines.append(line)


def event(label: str) -> SceneEvent:
    return SceneEvent(source="camera", label=label, captured=1.0, sent=1.0, session="s")


async def test_next_event_of_a_label_is_waited_for() -> None:
    camera = SceneCamera(cast(Any, SimpleNamespace(stdin=Input())))
    camera.take("scene/local", event("watching"))
    waiting = asyncio.create_task(camera.until_seen("watching"))
    await asyncio.sleep(0)
    assert not waiting.done(), "an earlier one does not count"
    camera.take("scene/local", event("watching"))
    await waiting
    assert (camera.count("watching"), camera.count("intrusion")) == (2, 0)


async def test_label_that_does_not_come_is_named() -> None:
    camera = SceneCamera(cast(Any, SimpleNamespace(stdin=Input())))
    camera.take("scene/local", event("blind"))
    with pytest.raises(Unmet, match=r"not published watching within 0\.01 s, only \['blind'\]"):
        await camera.until_seen("watching", within=0.01)


async def test_hand_and_harm_are_lines() -> None:
    read = Input()
    camera = SceneCamera(cast(Any, SimpleNamespace(stdin=read)))
    camera.show_hand()
    camera.tell("hand away")
    assert read.lines == [b"hand 0.3 0.45 0.3\n", b"hand away\n"]
