"""Presence of a label in the scene: seen for long enough with enough confidence, until it was not seen for a while."""

from __future__ import annotations

from pcmrs.messages.scene_event import SceneEvent
from pcmrs.scene.settings import SceneRuleSettings


class Presence:
    """Presence of the label of one rule, over all tracks: its memory does not grow with what a source sends.

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

    def take(self, event: SceneEvent, now: float) -> bool:
        """Take an event that the rule counts; return True if the label becomes present by it.

        Args:
            event: The event.
            now: Time of its arrival, s of the machine.
        """
        rule = self.rule
        if event.confidence < rule.least_confidence - (rule.hysteresis if self.present else 0.0):
            return False
        if self._since is None or now - self._seen > rule.gone_after:
            self._since, self.present = now, False
        self._seen, self.event = now, event
        if self.present or now - self._since < rule.lasts:
            return False
        self.present = True
        return True

    def expire(self, now: float) -> None:
        """End the presence of a label that was not seen for too long before the time `now`, s of the machine."""
        if self._since is not None and now - self._seen > self.rule.gone_after:
            self._since, self.present = None, False
