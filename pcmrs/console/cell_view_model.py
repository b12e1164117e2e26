"""What is known of a cell at one moment, and what panels show: the cell's own of now, or a recording's of then."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections import deque

from pcmrs.messages import BodyPose, DeviceEvent, Epoch, JointState, Snapshot, Verdict
from pcmrs.messages.health import Health
from pcmrs.messages.setup import ProcedureDataView

EVENTS = 500
"""So many of the newest decisions and events are kept."""
EPOCHS = 5
"""So many of the newest signals of a muscle are kept."""

NOTHING = ProcedureDataView(landmarks=[])


class CellViewModel(ABC):
    """The newest of everything.

    Attributes:
        snapshot: None before the first.
        data: What the procedure had gathered at the last snapshot.
        joints: None before the first.
        poses: By body.
        heard: When joints and bodies were heard last, s of `now`.
        events: Decisions and device events with their wall time, oldest first.
        epochs: What a muscle answered to the last pulses, oldest first.
        health: What the daemon found of itself; None where it does not say.
        version: Grows with everything that changes what a page says in words.
    """

    def __init__(self) -> None:
        self.snapshot: Snapshot | None = None
        self.data = NOTHING
        self.joints: JointState | None = None
        self.poses: dict[str, BodyPose] = {}
        self.heard: dict[str, float] = {}
        self.events: deque[tuple[float, Verdict | DeviceEvent]] = deque(maxlen=EVENTS)
        self.epochs: deque[Epoch] = deque(maxlen=EPOCHS)
        self.health: Health | None = None
        self.version = 0

    @property
    @abstractmethod
    def now(self) -> float:
        """The moment, s of a clock that only this knows."""

    def age(self, what: str) -> float | None:
        """Seconds since a body or the joints were heard; None if never."""
        return self.now - self.heard[what] if what in self.heard else None
