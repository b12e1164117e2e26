"""Presence of a label in the scene: seen for long enough with enough confidence, until it was not seen for a while."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from pcmrs.messages.scene_event import SceneEvent
from pcmrs.scene.settings import SceneRuleSettings

MOST_OBJECTS: Final = 64
"""Limit of objects that are distinguished at a time. All others count as one, so that no source fills the memory."""

Key = tuple[str, str, int | None] | None


@dataclass(slots=True)
class _Sighting:
    since: float
    seen: float
    present: bool


class Presence:
    """Presence of the label of one rule, over all tracks, and of each object with this label.

    An object is a track of a source in a region; a source without tracks has one object in each region. The label
    becomes present although its track changes. An object that becomes present later is new.

    Args:
        rule: The rule.

    Attributes:
        rule: The rule.
        present: True while the label is present.
        event: The newest event that counts; None before the first.
    """

    def __init__(self, rule: SceneRuleSettings) -> None:
        self.rule = rule
        self.present = False
        self.event: SceneEvent | None = None
        self._since: float | None = None
        self._seen = 0.0
        self._objects: dict[Key, _Sighting] = {}  # in the order in which they were seen last

    def take(self, event: SceneEvent, now: float) -> bool:
        """Take an event that the rule counts; return True if the label, or another object with it, becomes present.

        Args:
            event: The event.
            now: Time of its arrival, s of the machine.
        """
        rule = self.rule
        self.expire(now)
        if event.confidence < rule.least_confidence - (rule.hysteresis if self.present else 0.0):
            return False
        self._since = now if self._since is None else self._since
        self._seen, self.event = now, event
        is_new = self._take_object(event, now)
        if self.present or now - self._since < rule.lasts:
            return is_new and self.present
        self.present = True
        for sighting in self._objects.values():
            sighting.present = True
        return True

    def expire(self, now: float) -> None:
        """End the presence of what was not seen for too long before the time `now`, s of the machine."""
        if self._since is not None and now - self._seen > self.rule.gone_after:
            self._since, self.present = None, False
        while self._objects:
            oldest = next(iter(self._objects))
            if now - self._objects[oldest].seen <= self.rule.gone_after:
                return
            del self._objects[oldest]

    def _take_object(self, event: SceneEvent, now: float) -> bool:
        """Return True if the object of an event becomes present by it."""
        key: Key = (event.source, event.region, event.track)
        if key not in self._objects and len(self._objects) >= MOST_OBJECTS:
            key = None
        sighting = self._objects.get(key)
        if event.confidence < self.rule.least_confidence and not (sighting and sighting.present):
            return False
        sighting = self._objects.pop(key, None) or _Sighting(now, now, present=False)
        self._objects[key] = sighting
        sighting.seen = now
        if sighting.present or now - sighting.since < self.rule.lasts:
            return False
        sighting.present = True
        return True
