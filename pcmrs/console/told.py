"""What is known of a cell at one moment, and what panels show: the cell's own of now, or a recording's of then."""

from __future__ import annotations

from collections import deque

from pcmrs.messages import BodyPose, DeviceEvent, JointState, Snapshot, Verdict
from pcmrs.messages.setup import Gathered

EVENTS = 500
"""So many of the newest decisions and events are kept."""


class Told:
    """The newest of everything.

    Attributes:
        snapshot: None before the first.
        data: What the procedure had gathered at the last snapshot.
        joints: None before the first.
        poses: By body.
        heard: When joints and bodies were heard last, s of `now`.
        events: Decisions and device events with their wall time, oldest first.
        version: Grows with everything that changes what a page says in words.
    """

    def __init__(self) -> None:
        self.snapshot: Snapshot | None = None
        self.data = Gathered(landmarks=[])
        self.joints: JointState | None = None
        self.poses: dict[str, BodyPose] = {}
        self.heard: dict[str, float] = {}
        self.events: deque[tuple[float, Verdict | DeviceEvent]] = deque(maxlen=EVENTS)
        self.version = 0

    @property
    def now(self) -> float:
        """The moment, s of a clock that only this knows."""
        raise NotImplementedError

    def age(self, what: str) -> float | None:
        """Seconds since a body or the joints were heard; None if never."""
        return self.now - self.heard[what] if what in self.heard else None
