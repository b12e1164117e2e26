"""A tampered tracker changes the numbers or the stamp of frames, only when it is told to."""

from __future__ import annotations

from collections.abc import AsyncIterator, Sequence

from pcmrs.messages import BodyPose
from pcmrs_lab.campaign.explore.tampering import AHEAD, TamperedTracker


def pose(number: int, body: str = "coil") -> BodyPose:
    return BodyPose(
        body=body,
        frame_number=number,
        captured=10.0 + number,
        sent=10.1 + number,
        valid=True,
        position=(0.0, 0.0, 0.0),
        quat_wxyz=(1.0, 0.0, 0.0, 0.0),
    )


class ScriptedTracker:
    """A tracker with two bodies in each frame, and an empty frame."""

    name = "tracker"

    def __init__(self, *numbers: int | None) -> None:
        self._numbers = numbers

    async def frames(self) -> AsyncIterator[Sequence[BodyPose]]:
        for number in self._numbers:
            yield [] if number is None else [pose(number), pose(number, "body_ref")]


async def told(numbers: tuple[int | None, ...], **orders: int) -> list[Sequence[BodyPose]]:
    """Frames of a tracker that gets its orders before the frame of that index."""
    tracker = TamperedTracker(ScriptedTracker(*numbers))
    found: list[Sequence[BodyPose]] = []

    def order() -> None:
        for name, index in orders.items():
            if index == len(found):
                getattr(tracker, name)()

    order()
    async for frame in tracker.frames():
        found.append(frame)
        order()
    return found


async def test_nothing_is_changed_unless_told() -> None:
    found = await told((5, None, 6))
    assert found == [[pose(5), pose(5, "body_ref")], [], [pose(6), pose(6, "body_ref")]]


async def test_numbers_begin_again_with_the_next_frame() -> None:
    found = await told((5, None, 6, 9), restart=1)
    assert [each.frame_number for frame in found for each in frame] == [5, 5, 0, 0, 3, 3]
    assert [each.captured for frame in found for each in frame] == [15.0, 15.0, 16.0, 16.0, 19.0, 19.0]


async def test_one_frame_is_stamped_ahead() -> None:
    found = await told((5, 6, 7), stamp_ahead=1)
    first, ahead, last = (frame[0] for frame in found)
    assert (first, last) == (pose(5), pose(7))
    assert (ahead.frame_number, ahead.captured, ahead.sent) == (6, 16.0 + AHEAD, 16.1 + AHEAD)
    assert found[1][1].captured == ahead.captured, "the whole frame"


async def test_a_restart_is_not_undone_by_a_wrong_stamp() -> None:
    found = await told((5, 6, 7), restart=1, stamp_ahead=1)
    assert [frame[0].frame_number for frame in found] == [5, 0, 1]


def test_everything_else_is_the_tracker_itself() -> None:
    assert TamperedTracker(ScriptedTracker()).name == "tracker"
