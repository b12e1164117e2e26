"""The table ``scene_events`` of the configuration: sources of scene events, and what each label calls."""

from __future__ import annotations

from typing import Annotated, Any, Final

import msgspec

from pcmrs.messages.identity import LOCAL
from pcmrs.messages.scene_event import BLIND, WATCHING, SceneEvent

STOP: Final = "stop"
"""Value of `calls` that means Stop instead of an operation."""
REPORT: Final = "report"
"""Value of `when_lost` that means a report only."""
MOST_SOURCES: Final = 16
MOST_RULES: Final = 64

Positive = Annotated[float, msgspec.Meta(gt=0.0)]
NotNegative = Annotated[float, msgspec.Meta(ge=0.0)]
Share = Annotated[float, msgspec.Meta(ge=0.0, le=1.0)]


class SceneSourceSettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A source of scene events.

    Attributes:
        user: Name in the certificate of its process; `LOCAL` on the cell's own machine. Nobody else may send for it.
        silent_after: Time without a new frame, and age of a frame, from which the source counts as lost, s.
        returns_after: Time for which a lost source must send new frames before it counts again, s.
        rate_hz: Largest rate of its events over one second, Hz. Above it, the source counts as lost.
        when_lost: ``stop``: the robot is held and latched if a motion may run, and no approach begins until the source
            has returned. ``report``: the loss is reported only. Otherwise the event operation to call,
            ``branch.operation``.
    """

    user: str = LOCAL
    silent_after: Positive = 0.5
    returns_after: NotNegative = 1.0
    rate_hz: Annotated[float, msgspec.Meta(ge=1.0, le=1000.0)] = 200.0
    when_lost: str = STOP


class SceneRuleSettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A rule: what a label calls. Times are those of the machine.

    Attributes:
        label: Label of the events.
        calls: ``stop``, or the event operation to call, ``branch.operation``.
        sources: Sources whose events count; empty for all.
        regions: Regions in which events count; empty for all.
        least_confidence: Confidence from which an event counts.
        hysteresis: Amount by which the confidence may fall below `least_confidence` while the label is present.
        lasts: Time for which the label must be seen before it is present, s.
        gone_after: Time without an event that counts after which the label is not present any more, s.
        states: Branch to states in which a ``stop`` acts, beside any motion that runs. Empty: all states in which a
            motion may run.
        arguments: Names of the event's arguments that are passed on to the operation.

    Raises:
        ValueError: The hysteresis is not below the least confidence, the label is reserved, or a Stop has arguments.
    """

    label: str
    calls: str = STOP
    sources: tuple[str, ...] = ()
    regions: tuple[str, ...] = ()
    least_confidence: Share = 0.5
    hysteresis: Share = 0.1
    lasts: NotNegative = 0.0
    gone_after: Positive = 0.5
    states: dict[str, list[str]] = {}
    arguments: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if self.label in (WATCHING, BLIND):
            raise ValueError(f"the label {self.label!r} is a sign of life of a source, which no rule may use")
        if self.hysteresis >= self.least_confidence:
            text = f"hysteresis is {self.hysteresis:g}, which must be less than least_confidence"
            raise ValueError(f"{text}, {self.least_confidence:g}: otherwise {self.label} never ends")
        if self.calls == STOP and self.arguments:
            raise ValueError(f"the rule for {self.label!r} calls stop, which takes no arguments")
        if self.calls != STOP and self.states:
            text = f"the rule for {self.label!r} calls {self.calls}, whose own states decide: leave out states"
            raise ValueError(text)

    def counts(self, event: SceneEvent) -> bool:
        """Return True if the rule is about events of this label, source and region."""
        return (
            event.label == self.label
            and (not self.sources or event.source in self.sources)
            and (not self.regions or event.region in self.regions)
        )


class SceneEventSettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Sources of scene events, and rules for them. Without a source, no scene event has an effect.

    Attributes:
        sources: Sources by name.
        rules: Rules, each on its own.

    Raises:
        ValueError: There are too many sources or rules, or a rule names an unknown source.
    """

    sources: dict[str, SceneSourceSettings] = {}
    rules: tuple[SceneRuleSettings, ...] = ()

    def __post_init__(self) -> None:
        if len(self.sources) > MOST_SOURCES or len(self.rules) > MOST_RULES:
            text = f"{len(self.sources)} sources and {len(self.rules)} rules are too many"
            raise ValueError(f"{text}: at most {MOST_SOURCES} and {MOST_RULES}")
        if self.rules and not self.sources:
            raise ValueError("scene_events has rules, but no source: add a table scene_events.sources.NAME")
        for rule in self.rules:
            for name in rule.sources:
                if name not in self.sources:
                    known = ", ".join(self.sources)
                    raise ValueError(f"the rule for {rule.label!r} names the source {name!r}; there are {known}")

    def called(self) -> list[tuple[str, str, tuple[str, ...]]]:
        """Return where an operation is called, its name ``branch.operation``, and the arguments that it gets."""
        lost: list[tuple[str, str, tuple[str, ...]]] = [
            (f"sources.{name}.when_lost", source.when_lost, ())
            for name, source in self.sources.items()
            if source.when_lost not in (STOP, REPORT)
        ]
        return lost + [
            (f"the rule for {rule.label}", rule.calls, rule.arguments) for rule in self.rules if rule.calls != STOP
        ]


def passed_on(rule: SceneRuleSettings, event: SceneEvent) -> dict[str, Any]:
    """Return the arguments of an event that the operation of a rule gets.

    Args:
        rule: The rule.
        event: The event.
    """
    return {name: event.arguments[name] for name in rule.arguments if name in event.arguments}
