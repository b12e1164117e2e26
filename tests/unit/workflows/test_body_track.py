"""The body's present pose from frames of the tracker that arrive late."""

from __future__ import annotations

import numpy as np
import pytest

from pcmrs.devices.poses import Sighting
from pcmrs.errors import RefusalError
from pcmrs.spatial import Transform
from pcmrs.workflows._body_track import BodyTrack
from pcmrs.workflows.settings import FollowingSettings

SPEED = 0.010
"""Of the body along x, m/s."""
LATENCY = 0.05


def sighting(number: int, session: str = "") -> Sighting:
    """Return the pose of a drifting body in a frame of 60 Hz, on a tracker whose clock is ahead by 100 s."""
    exposed = 100.0 + number / 60.0
    there = Transform(np.eye(3), np.array((SPEED * exposed, 0.0, 1.0)))
    return Sighting(number, exposed, captured=exposed - 100.0 + LATENCY, tracker_from_body=there, session=session)


def track_of(settings: FollowingSettings, frames: int = 10) -> BodyTrack:
    track = BodyTrack(settings)
    for number in range(frames):
        track.take({"coil": sighting(number), "body_ref": sighting(number)})
    return track


def test_uncompensated_target_pose_is_the_newest_pose_seen() -> None:
    """Of a body that drifts: with compensation it is wanted where the body is by now, ahead of what was seen."""
    stamps = {
        compensated: track_of(FollowingSettings(compensated=compensated)).stamp(sighting(9).captured + 0.02)
        for compensated in (True, False)
    }
    assert stamps[False] == sighting(9).exposed
    assert stamps[True] > sighting(9).exposed + 0.02


def test_a_drifting_body_is_predicted_over_the_latency() -> None:
    settings = FollowingSettings(lead=0.0, farthest_lead=1.0)
    now = sighting(59).captured + 0.03
    track = track_of(settings, 60)
    stamp = track.stamp(now)
    assert stamp - sighting(59).exposed == pytest.approx(0.03)
    assert track.pose(stamp).translation[0] == pytest.approx(SPEED * stamp, abs=2e-5)


def test_prediction_goes_no_farther_than_configured() -> None:
    track = track_of(FollowingSettings(farthest_lead=1e-4), 60)
    ahead = track.stamp(sighting(59).captured + 0.1) - sighting(59).exposed
    assert ahead * SPEED == pytest.approx(1e-4, rel=0.02)


def test_a_body_unseen_for_too_long_is_refused_with_its_age() -> None:
    settings = FollowingSettings()
    newest = sighting(9).captured
    track = track_of(settings)
    track.stamp(newest + settings.longest_gap - 1e-6)
    with pytest.raises(RefusalError, match="does not follow an unseen body") as refused:
        track.stamp(newest + settings.longest_gap + 0.01)
    assert refused.value.refusal_code == "pose_stale"
    assert refused.value.fields["age"] == pytest.approx(settings.longest_gap + 0.01)
    assert refused.value.fields["limit"] == settings.longest_gap
    with pytest.raises(RefusalError):
        BodyTrack(settings).stamp(0.0)


def test_frames_of_a_restarted_tracker_are_refused() -> None:
    track = track_of(FollowingSettings())
    other = sighting(10, session="second")
    with pytest.raises(RefusalError, match="The tracker was restarted") as refused:
        track.take({"coil": other, "body_ref": other})
    assert refused.value.refusal_code == "tracker_restarted"
