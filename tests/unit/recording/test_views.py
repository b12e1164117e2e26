"""Views for people, from messages of the bus."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from pcmrs.bus.codec import pack
from pcmrs.messages import DeviceEvent, Message, PoseMessage, Target
from pcmrs.recording._foxglove_messages import FoxgloveView
from pcmrs.recording.subscriber import RawSample
from pcmrs.recording.views import RecordingViews
from tests.unit.recording.recording_bench import ARM, MOUNTING, joints, pose, read_back


@pytest.mark.parametrize(
    "payload", [b"", b"\xc1", b"{", pack(joints([0.0] * 3)), pack(joints([math.pi] * 6 + [1e300]))[:-9]]
)
def test_unreadable_message_is_logged_and_stored_unchanged(payload: bytes) -> None:

    views = RecordingViews(ARM, MOUNTING, 1.0)
    read = ("joints", "pose/coil", "fsm", "target", "data", "epoch", "health", "event")
    for key in (*(f"state/{each}" for each in read), "dev/robot/state"):
        shown = views.of(RawSample(key, payload, 1.0), 10**18)
        assert [topic for topic, _ in shown] in (["/log"], []), key
    assert views.of(RawSample("state/unheard", payload, 1.0), 10**18) == []


NOW = 10**18


def sample(key: str, message: Message) -> RawSample:
    return RawSample(key, pack(message), 1.0)


def topics(shown: list[tuple[str, FoxgloveView]]) -> list[str]:
    return [topic for topic, _ in shown]


def target(*, planned: bool = True, registered: bool = True) -> Target:
    here = PoseMessage(position=(0.0, 0.0, 0.1), quat_wxyz=(1.0, 0.0, 0.0, 0.0))
    return Target(plan="p", pose=here if planned else None, body_ref_from_image=here if registered else None)


def test_a_file_starts_with_what_still_holds() -> None:
    views = RecordingViews(ARM, MOUNTING, 1.0)
    assert topics(views.opening(NOW)) == ["/tf/calibration"] * 3
    views.of(sample("state/joints", joints()), NOW)
    views.of(sample("state/pose/coil", pose("coil")), NOW)
    views.of(sample("state/target", target()), NOW)
    views.of(sample("state/event", DeviceEvent(device="robot", code="x", text="")), NOW)
    assert set(topics(views.opening(NOW))) == {"/tf/calibration", "/tf/robot_base", "/tf/image", "/target"}


def test_abandoned_plan_and_registration_do_not_come_back() -> None:
    views = RecordingViews(ARM, MOUNTING, 1.0)
    views.of(sample("state/target", target()), NOW)
    views.of(sample("state/target", target(planned=False)), NOW)
    assert set(topics(views.opening(NOW))) == {"/tf/calibration", "/tf/image"}
    views.of(sample("state/target", target(planned=False, registered=False)), NOW)
    assert set(topics(views.opening(NOW))) == {"/tf/calibration"}


@pytest.mark.parametrize(
    ("rate", "age", "shown_s"), [(1.0, 0.03, 0.03), (5.0, 0.5, 0.1), (1.0, -1.0, 0.0), (1.0, 1e9, 0.0)]
)
def test_a_measurement_is_as_old_as_its_sender_says(rate: float, age: float, shown_s: float, tmp_path: Path) -> None:
    """In seconds of the machine; an implausible age counts as none."""
    views = RecordingViews(ARM, MOUNTING, rate)
    shown = views.of(sample("state/pose/pointer", pose("pointer", captured=2.0, sent=2.0 + age)), NOW)
    ((topic, links),) = read_back(shown, tmp_path / "run.mcap")
    assert topic == "/tf/bodies"
    at = links.transforms[0].timestamp
    assert NOW - (at.seconds * 10**9 + at.nanos) == pytest.approx(shown_s * 1e9, abs=1000)


def test_a_hidden_body_and_a_moving_arm_show_no_new_place() -> None:
    views = RecordingViews(ARM, MOUNTING, 1.0)
    assert views.of(sample("state/pose/coil", pose("coil", valid=False, reason="hidden")), NOW) == []
    views.of(sample("state/joints", joints(moving=True)), NOW)
    assert topics(views.of(sample("state/pose/coil", pose("coil")), NOW)) == ["/tf/bodies"]
    views.of(sample("state/joints", joints()), NOW)
    assert topics(views.of(sample("state/pose/coil", pose("coil")), NOW)) == ["/tf/bodies", "/tf/robot_base"]


def test_base_of_a_standing_robot_is_shown_once_a_second() -> None:
    views, seen = RecordingViews(ARM, MOUNTING, 1.0), sample("state/pose/coil", pose("coil"))

    def base_shown(after_ns: int) -> bool:
        return "/tf/robot_base" in topics(views.of(seen, NOW + after_ns))

    views.of(sample("state/joints", joints()), NOW)
    assert [base_shown(each) for each in (0, 10**8, 10**9 - 1, 10**9, 11 * 10**8)] == [True, False, False, True, False]
    views.of(sample("state/joints", joints(moving=True)), NOW)
    views.of(sample("state/joints", joints()), NOW)
    assert base_shown(12 * 10**8), "the arm has moved since"
