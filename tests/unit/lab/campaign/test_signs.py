"""Signs of a tracker's fault: each is seen in a frame that shows it, and in no frame that does not."""

from __future__ import annotations

import asyncio
import math
from typing import Any, cast

import pytest

from pcmrs.bus import Bus
from pcmrs.messages import BodyPose
from pcmrs.testing.errors import Unmet
from pcmrs_lab.campaign.signs import SIGNS, SILENCE, ReceivedPoses, poses, shown
from pcmrs_sim.faults import FAULTS
from tests.unit.lab.campaign.scripted_cell import IDENTITY, ScriptedBus, ScriptedCell, run


def pose(number: int, **changed: Any) -> BodyPose:
    """A frame of a coil at rest, 60 a second."""
    time = 100.0 + number / 60.0
    given: dict[str, Any] = {
        "body": "coil",
        "frame_number": number,
        "captured": time,
        "sent": time + 0.02,
        "valid": True,
    }
    return BodyPose(**(given | {"position": (0.1, 0.2, 0.3), "quat_wxyz": IDENTITY, "error": 1e-4} | changed))


SHOWING: dict[str, tuple[dict[str, Any], dict[str, Any]]] = {
    "occlude": ({"valid": False}, {}),
    "frame_frozen": ({"frame_number": 1}, {}),
    "pose_not_unit": ({"quat_wxyz": (1.2, 0.0, 0.0, 0.0)}, {}),
    "pose_jump": ({"position": (0.1, 0.2, 0.32)}, {}),
    "not_measured": ({"valid": False, "reason": "temperature"}, {"reason": "temperature"}),
    "bad_fit": ({"error": 3e-3}, {}),
    "phantom_marker": ({"position": (0.1, 0.22, 0.3)}, {}),
    "tool_swap": ({"position": (0.5, 0.2, 0.3)}, {}),
    "wrong_tool": ({"valid": False, "reason": "wrong_tool"}, {}),
    "tracker_rate": ({"captured": 100.25, "sent": 100.27}, {}),
    "stamp_reversed": ({"captured": 99.0}, {}),
    "stamp_future": ({"captured": 3700.0}, {}),
    "dash_head": ({"position": (0.1015, 0.2, 0.3)}, {}),
}
"""Fault to what its frame has that others have not, and to the arguments of the fault."""


def received(*frames: BodyPose, bus: ScriptedBus | None = None) -> ReceivedPoses:
    seen = ReceivedPoses(cast(Bus, bus or ScriptedBus()))
    for frame in frames:
        seen.take(frame)
    return seen


def test_every_sign_has_a_frame_that_shows_it() -> None:
    assert SHOWING.keys() == SIGNS.keys()
    assert SIGNS.keys() <= FAULTS.keys()


@pytest.mark.parametrize("name", SHOWING)
def test_a_sign_is_seen_where_it_is_and_nowhere_else(name: str) -> None:
    changed, arguments = SHOWING[name]
    quiet = [pose(number) for number in range(5)]
    assert received(*quiet).count_showing(name, arguments) == 0
    frames = [*quiet[:2], pose(2, **changed)]
    assert received(*frames).count_showing(name, arguments) == 1
    assert shown(received(*frames), name, arguments) == {"frames": 1, "of": 3}
    with pytest.raises(Unmet, match=f"No subscriber has seen '{name}'"):
        shown(received(*quiet), name, arguments)


def test_frames_of_two_bodies_are_not_compared() -> None:
    far = pose(1, body="body_ref", position=(0.9, 0.9, 0.9))
    assert received(pose(1), far, pose(2), far).count_showing("pose_jump", {}) == 0


def test_another_reason_is_not_the_injected_one() -> None:
    frames = (pose(1), pose(2, valid=False, reason="interference"))
    assert received(*frames).count_showing("not_measured", {"reason": "temperature"}) == 0


def test_frames_that_are_not_measured_do_not_leap() -> None:
    lost = pose(2, valid=False, position=(0.0, 0.0, 0.0))
    assert received(pose(1), lost, pose(3)).count_showing("tool_swap", {}) == 0


def test_numbers_that_no_bus_accepts_are_counted_by_it() -> None:
    bus = ScriptedBus()
    bus.counts["bus.ignored"] = 7
    seen = received(pose(1), bus=bus)
    with pytest.raises(Unmet, match="pose_nan"):
        shown(seen, "pose_nan", {})
    bus.counts["bus.ignored"] = 9
    assert shown(seen, "pose_nan", {}) == {"frames": 2}


def test_an_absent_tracker_is_silent_for_long_enough(monkeypatch: pytest.MonkeyPatch) -> None:
    async def look(silence: float) -> dict[str, float]:
        seen = received(pose(1))
        await asyncio.sleep(silence)
        return shown(seen, "tracker_absent", {})

    assert run(monkeypatch, look(1.5)) == {"silent_s": 1.5}
    with pytest.raises(Unmet, match="tracker_absent"):
        run(monkeypatch, look(0.9 * SILENCE))


def test_nothing_is_injected_before_the_first_frame_has_come(monkeypatch: pytest.MonkeyPatch) -> None:
    async def collect(comes: bool) -> int:
        cell = ScriptedCell()
        if comes:
            loop = asyncio.get_running_loop()
            loop.call_later(0.5, lambda: cell.bus.handlers["state/pose/coil"]("", pose(1)))
        try:
            async with poses(cell.as_cell, "coil") as seen:
                return len(seen.received)
        finally:
            assert cell.bus.handlers == {}

    assert run(monkeypatch, collect(comes=True)) == 1
    with pytest.raises(Unmet, match="No frame of the tracker is received without the fault"):
        run(monkeypatch, collect(comes=False))


def test_a_dash_is_a_speed_and_not_a_distance() -> None:
    slow = [pose(0), pose(60, position=(0.1015, 0.2, 0.3))]
    assert received(*slow).count_showing("dash_head", {}) == 0, "1.5 mm in a second"
    same_time = [pose(0), pose(1, captured=100.0, position=(0.2, 0.2, 0.3))]
    assert received(*same_time).count_showing("dash_head", {}) == 0
    assert math.isclose(SILENCE * 60.0, 24.0)
