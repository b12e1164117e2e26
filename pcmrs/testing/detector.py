"""A detector of scene events that a test controls, for cells that have a table ``scene_events``."""

from __future__ import annotations

import uuid
from collections.abc import Callable
from typing import Any

from pcmrs.clock import Clock
from pcmrs.messages import SceneEvent
from pcmrs.messages.scene_event import BLIND, WATCHING

__all__ = ["ScriptedDetector"]


class ScriptedDetector:
    """Detector without a camera: it sends what the test has it see, frame by frame.

    Args:
        publish: Publishes an event under a key.
        clock: Clock of the detector's machine.
        source: Name of the source in the cell's table ``scene_events.sources``.
        user: User of that source.
        rate_hz: Rate of the frames, Hz.

    Attributes:
        sees: Label to further fields of its event, in each frame.
        frozen: True if the camera repeats its last frame.
        silent: True if nothing is sent.
        blind: Reason why the detector cannot see; empty if it can.
        repeats: Number of times that each event is sent.
    """

    def __init__(
        self,
        publish: Callable[[str, SceneEvent], None],
        clock: Clock,
        source: str = "camera",
        user: str = "local",
        rate_hz: float = 10.0,
    ) -> None:
        self.sees: dict[str, dict[str, Any]] = {}
        self.frozen = self.silent = False
        self.blind = ""
        self.repeats = 1
        self._publish = publish
        self._clock = clock
        self._source = source
        self._key = f"scene/{user}"
        self._period = 1.0 / rate_hz
        self._session = uuid.uuid4().hex
        self._captured = clock.monotonic()

    async def run(self) -> None:
        """Send frames until cancelled."""
        while True:
            self.send_frame()
            await self._clock.sleep(self._period)

    def send_frame(self) -> None:
        """Send the events of one frame now."""
        if not self.frozen:
            self._captured = self._clock.monotonic()
        if self.silent:
            return
        for _ in range(self.repeats):
            if self.blind:
                self._send(BLIND, reason=self.blind)
                continue
            for label, fields in self.sees.items():
                self._send(label, **fields)
            self._send(WATCHING)

    def _send(self, label: str, **fields: Any) -> None:
        event = SceneEvent(
            source=self._source,
            label=label,
            captured=self._captured,
            sent=self._clock.monotonic(),
            session=self._session,
            **fields,
        )
        self._publish(self._key, event)
