"""Tracks of objects over frames: each gets a number that it keeps, and a confidence that grows as it is seen again."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from pcmrs.scene._clusters import Cluster

SURE_AFTER: Final = 2
"""Number of frames after which a track has full confidence."""
FORGOTTEN_AFTER: Final = 5
"""Number of frames without its object after which a track ends."""
MOST_TRACKS: Final = 32


@dataclass(slots=True)
class Track:
    """One tracked object.

    Attributes:
        number: Number of the track.
        cluster: Its newest cluster.
        seen: Number of frames in which it was seen.
        missed: Number of frames since then.
    """

    number: int
    cluster: Cluster
    seen: int = 1
    missed: int = 0

    @property
    def confidence(self) -> float:
        """Confidence that it is an object, 0 to 1: noise is seen once."""
        return min(1.0, self.seen / SURE_AFTER)


class Tracker:
    """Assigns the clusters of each frame to tracks, nearest pairs first.

    Args:
        gate: Distance that an object moves at most between two frames, m.
    """

    def __init__(self, gate: float) -> None:
        self._gate = gate
        self._tracks: list[Track] = []
        self._number = 0

    def update(self, clusters: Sequence[Cluster]) -> list[Track]:
        """Take the clusters of a frame, and return the tracks that are seen in it."""
        pairs = sorted(
            (distance, t, c)
            for t, track in enumerate(self._tracks)
            for c, cluster in enumerate(clusters)
            if (distance := float(np.linalg.norm(track.cluster.middle - cluster.middle))) <= self._gate
        )
        matched: dict[int, int] = {}
        for _, t, c in pairs:
            if t not in matched.values() and c not in matched:
                matched[c] = t
        for t, track in enumerate(self._tracks):
            if t not in matched.values():
                track.missed += 1
        shown = [self._assign(cluster, matched.get(c)) for c, cluster in enumerate(clusters[:MOST_TRACKS])]
        self._tracks = [track for track in self._tracks if track.missed <= FORGOTTEN_AFTER][-MOST_TRACKS:]
        return shown

    def _assign(self, cluster: Cluster, index: int | None) -> Track:
        if index is None:
            self._number += 1
            track = Track(self._number, cluster)
            self._tracks.append(track)
            return track
        track = self._tracks[index]
        track.cluster, track.missed = cluster, 0
        track.seen += 1
        return track
