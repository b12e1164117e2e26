"""Faults of a tour: the scene has one for exactly as long as the event is waited for."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, cast

import pytest

from pcmrs.client import Client
from pcmrs_lab.experiment.tours.faults import FAULTS, fault
from pcmrs_sim.scene import SimScene


class Scene:
    """Keeps what is asked of it."""

    def __init__(self) -> None:
        self.asked: list[tuple[str, str, Mapping[str, Any]]] = []

    async def request_device(self, device: str, method: str, arguments: Mapping[str, Any]) -> None:
        self.asked.append((device, method, arguments))


@pytest.mark.parametrize("event", [name for name, each in FAULTS.items() if each is not None])
async def test_a_fault_is_ended_also_when_its_event_does_not_come(event: str) -> None:
    scene, wrong = Scene(), FAULTS[event]
    assert wrong is not None

    async def wait() -> None:
        async with fault(cast(Client, scene), event):
            assert scene.asked == [("scene", wrong.method, wrong.begin)]
            raise TimeoutError

    with pytest.raises(TimeoutError):
        await wait()
    assert scene.asked[1:] == [("scene", wrong.method, wrong.end)]


async def test_an_event_that_comes_by_itself_needs_no_fault() -> None:
    scene = Scene()
    async with fault(cast(Client, scene), "within"):
        pass
    assert scene.asked == []


@pytest.mark.parametrize("event", [name for name, each in FAULTS.items() if each is not None])
def test_the_simulated_scene_has_every_fault(event: str) -> None:
    wrong = FAULTS[event]
    assert wrong is not None
    assert callable(getattr(SimScene, wrong.method))
    assert wrong.begin.keys() == wrong.end.keys()
    assert wrong.begin != wrong.end


def test_a_reference_that_slipped_is_put_back_where_it_was() -> None:
    slipped = FAULTS["reference_moved"]
    assert slipped is not None
    there, back = slipped.begin["offset_in_body_ref"], slipped.end["offset_in_body_ref"]
    assert [one + other for one, other in zip(there, back, strict=True)] == [0.0, 0.0, 0.0]
