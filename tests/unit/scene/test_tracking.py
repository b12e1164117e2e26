"""An object keeps its number while it moves, and is sure once it was seen again."""

from __future__ import annotations

import numpy as np

from pcmrs.scene._clusters import Cluster
from pcmrs.scene._tracking import FORGOTTEN_AFTER, MOST_TRACKS, Tracker


def at(x: float) -> Cluster:
    return Cluster("bench", np.array((x, 0.0, 0.0)), 0.1, 50)


def test_moving_object_keeps_its_number_and_becomes_sure() -> None:
    tracker = Tracker(0.2)
    tracks = [tracker.update([at(0.1 * step)])[0] for step in range(3)]
    assert {track.number for track in tracks} == {1}
    assert Tracker(0.2).update([at(0.0)])[0].confidence == 0.5
    assert tracks[-1].confidence == 1.0


def test_two_objects_are_told_apart_when_they_come_near() -> None:
    tracker = Tracker(0.5)
    tracker.update([at(0.0), at(1.0)])
    tracker.update([at(0.9), at(0.3)])
    numbers = {track.number: track.cluster.middle[0] for track in tracker.update([at(0.4), at(0.8)])}
    assert numbers == {1: 0.4, 2: 0.8}


def test_object_that_jumps_is_a_new_one() -> None:
    tracker = Tracker(0.2)
    tracker.update([at(0.0)])
    assert [track.number for track in tracker.update([at(1.0)])] == [2]


def test_hidden_object_is_known_again_for_a_while() -> None:
    tracker = Tracker(0.2)
    tracker.update([at(0.0)])
    for _ in range(FORGOTTEN_AFTER):
        assert tracker.update([]) == []
    assert tracker.update([at(0.1)])[0].number == 1
    for _ in range(FORGOTTEN_AFTER + 1):
        tracker.update([])
    assert tracker.update([at(0.1)])[0].number == 2


def test_number_of_tracks_is_bounded() -> None:
    tracker = Tracker(0.01)
    for step in range(10):
        assert len(tracker.update([at(number + step / 10) for number in range(100)])) == MOST_TRACKS
