"""State of a cell at one moment, as panels show it: the present state, or that of a recording."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections import deque

from pcmrs.messages import BodyPose, DeviceEvent, Epoch, JointState, Snapshot, Verdict
from pcmrs.messages.health import Health
from pcmrs.messages.setup import ProcedureDataView

EVENTS = 500
"""Number of the newest decisions and events that are kept."""
EPOCHS = 5
"""Number of the newest signals of a muscle that are kept."""

NOTHING = ProcedureDataView(landmarks=[])


class CellViewModel(ABC):
    """Newest state of everything.

    Attributes:
        snapshot: Newest snapshot; None before the first.
        data: Data of the procedure at the last snapshot.
        joints: Newest joints; None before the first.
        poses: Body to its newest pose.
        received: Time of the last message of the joints and of each body, s of `now`.
        events: Decisions and device events with their wall time, oldest first.
        epochs: Signals of a muscle after the last pulses, oldest first.
        health: Health of the daemon; None if it is not reported.
        version: Number that grows with every change of the texts on a page.
    """

    def __init__(self) -> None:
        self.snapshot: Snapshot | None = None
        self.data = NOTHING
        self.joints: JointState | None = None
        self.poses: dict[str, BodyPose] = {}
        self.received: dict[str, float] = {}
        self.events: deque[tuple[float, Verdict | DeviceEvent]] = deque(maxlen=EVENTS)
        self.epochs: deque[Epoch] = deque(maxlen=EPOCHS)
        self.health: Health | None = None
        self.version = 0

    @property
    @abstractmethod
    def now(self) -> float:
        """The moment, s of this object's own clock."""

    def age(self, what: str) -> float | None:
        """Return the seconds since a body or the joints were received; None if never."""
        return self.now - self.received[what] if what in self.received else None
