"""Watch of the sources of scene events: it stops the robot, bars motion, and calls operations by the cell's table."""

from __future__ import annotations

import uuid
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any, Final

import structlog

from pcmrs.bus.keys import named_in
from pcmrs.clock import Clock
from pcmrs.dispatcher import Dispatcher
from pcmrs.dispatcher.events import DAEMON, SCENE_NOT_CLEAR
from pcmrs.fsm import Blueprint, Closure
from pcmrs.messages import Command, DeviceEvent, Reason
from pcmrs.messages.scene_event import SceneEvent
from pcmrs.scene.liveness import Liveness
from pcmrs.scene.presence import Presence
from pcmrs.scene.settings import REPORT, STOP, SceneEventSettings, SceneRuleSettings, passed_on
from pcmrs.service.supervisor import mark

log = structlog.get_logger(__name__)

PERIOD: Final = 0.05
"""Period of the checks for silent sources and labels that are gone, s of the machine."""

HELD_UP: Final = 0.1
"""Delay from which the watch itself was held up, s: it first takes the events that have arrived meanwhile."""

INTRUSION: Final = "scene_intrusion"
"""Code of the danger event that a label which calls Stop is seen while a motion may run."""
SEEN: Final = "scene_seen"
"""Code of the event that a label is present whose rule does not stop, or calls an operation.

It is a danger if the operation changes what a motion requires, and a motion may run.
"""
LOST: Final = "scene_lost"
"""Code of the event that a source is lost; a danger if a motion may run, and it calls Stop or such an operation."""
RETURNED: Final = "scene_returned"
"""Code of the event that a lost source sends again."""
_LOSSES: Final = {
    "silent": "has sent nothing for {limit:g} s",
    "stale": "has sent no new frame for {limit:g} s",
    "flooded": "has sent more than {rate:g} events per second",
    "blind": "cannot see the scene ({blind})",
    "two_senders": "is sent by two processes at the same time",
}


@dataclass(slots=True)
class _Source:
    name: str
    liveness: Liveness
    reported: bool = False

    @property
    def text(self) -> str:
        settings = self.liveness.settings
        values = {"limit": settings.silent_after, "rate": settings.rate_hz, "blind": self.liveness.blind or "no reason"}
        return f"The source {self.name} of scene events {_LOSSES[self.liveness.lost or 'silent'].format(**values)}."


class SceneWatch:
    """Watch over the sources of scene events; see docs/scene.md.

    A label that calls Stop takes the lane of Stop at the event by which it, or another object with it, becomes present,
    if a motion may run. While it is present, and while a source whose loss calls Stop is lost, no motion towards the
    patient begins, and one that has begun anyway is stopped. A retreat that begins in this situation is not stopped
    again: nobody may be kept from leaving the patient.

    Args:
        settings: Sources and rules.
        dispatcher: The dispatcher, which stops and takes the commands.
        clock: Clock of the machine.

    Attributes:
        foreign: Number of events that were dropped, since their sender may not send for their source.
    """

    def __init__(self, settings: SceneEventSettings, dispatcher: Dispatcher[Any, Any], clock: Clock) -> None:
        self.foreign = 0
        self._settings = settings
        self._dispatcher = dispatcher
        self._clock = clock
        self._sources = {name: _Source(name, Liveness(each, clock)) for name, each in settings.sources.items()}
        self._presences = [Presence(rule) for rule in settings.rules]
        self._may_move = _MotionStates(dispatcher)

    @property
    def has_sources(self) -> bool:
        """True if the cell has a source of scene events."""
        return bool(self._sources)

    def take(self, key: str, event: SceneEvent) -> None:
        """Take an event from the bus.

        Args:
            key: Relative key, ``scene/<user>``.
            event: The event.
        """
        source = self._sources.get(event.source)
        if source is None or source.liveness.settings.user != named_in(key):
            self.foreign += 1
            if self.foreign.bit_count() == 1:  # 1, 2, 4, 8 …: a flood must not fill the log
                log.warning("foreign_scene_event", key=key, source=event.source, count=self.foreign)
            return
        if source.liveness.take(event):
            now = self._clock.monotonic()
            for presence in self._presences:
                if not presence.rule.counts(event):
                    continue
                presence.expire(now)
                first = not presence.present
                if presence.take(event, now):
                    self._begin(presence.rule, event, first=first)
        self._check([source])

    async def run(self) -> None:
        """Check until cancelled; what was held up takes the events first, but not twice in a row without a check."""
        skips = False
        while True:
            mark()
            begun = self._clock.monotonic()
            await self._clock.sleep(PERIOD)
            held_up = self._clock.monotonic() - begun - PERIOD > HELD_UP
            skips = held_up and not skips
            self._check([] if skips else self._sources.values())

    def _check(self, sources: Iterable[_Source]) -> None:
        """Find labels that are gone, and which of the sources are lost; then bar or allow motion."""
        now = self._clock.monotonic()
        for presence in self._presences:
            presence.expire(now)
        for source in sources:
            lost = source.liveness.check() is not None
            if lost != source.reported:
                source.reported = lost
                self._on_loss(source) if lost else self._on_return(source)
        reason = self._not_clear()
        self._dispatcher.bar_motion(reason)
        dispatcher, latched = self._dispatcher, self._dispatcher.procedure.latched
        if reason is not None and not latched and dispatcher.moving and not dispatcher.only_retreats:
            self._report(DeviceEvent(device="scene", code=reason.fields["cause"], text=reason.text, danger=True), None)

    def _begin(self, rule: SceneRuleSettings, event: SceneEvent, *, first: bool) -> None:
        """Do what a rule calls, at the event by which its label, or another object with it, has become present.

        Another object may stop; it is not reported otherwise, so that a source with unsteady tracks fills no journal.
        """
        stops = rule.calls == STOP and self._acts_now(rule)
        call = None if rule.calls == STOP else _command(event.source, rule.calls, passed_on(rule, event))
        danger = stops or (first and call is not None and self._takes_from_a_motion(call))
        where = f" in {event.region}" if event.region else ""
        text = f"{event.source} sees {event.label}{where} (confidence {event.confidence:.2f})"
        text += ": the robot is held. Look at the cell; when it is clear, acknowledge." if danger else "."
        fields = {
            "source": event.source,
            "label": event.label,
            "confidence": event.confidence,
            "track": event.track,
            "position": event.position,
            "frame": event.frame,
            "region": event.region,
            "age": event.sent - event.captured,
            "calls": rule.calls,
        }
        shown = DeviceEvent(
            device=f"scene:{event.source}", code=INTRUSION if stops else SEEN, text=text, danger=danger, fields=fields
        )
        if danger or first:
            self._report(shown, call)

    def _on_loss(self, source: _Source) -> None:
        calls = source.liveness.settings.when_lost
        call = None if calls in (STOP, REPORT) else _command(source.name, calls, {})
        danger = calls == STOP and not self._dispatcher.procedure.latched and self._may_move.now()
        danger = danger or (call is not None and self._takes_from_a_motion(call))
        event = DeviceEvent(
            device=f"scene:{source.name}",
            code=LOST,
            text=f"{source.text} Look at its camera and its process.",
            danger=danger,
            fields={
                "source": source.name,
                "why": source.liveness.lost,
                "blind": source.liveness.blind,
                "ahead": source.liveness.ahead,
            },
        )
        log.warning(LOST, **event.fields)
        self._report(event, call)

    def _on_return(self, source: _Source) -> None:
        text = f"The source {source.name} of scene events sends new frames again."
        self._dispatcher.report_later(DeviceEvent(device=f"scene:{source.name}", code=RETURNED, text=text))

    def _not_clear(self) -> Reason | None:
        """Why no motion towards the patient may begin now; None if it may."""
        for source in self._sources.values():
            if source.reported and source.liveness.settings.when_lost == STOP:
                text = f"{source.text} Nothing approaches until it has sent for some time again."
                return Reason(code=SCENE_NOT_CLEAR, text=text, fields={"source": source.name, "cause": LOST})
        for presence in self._presences:
            if presence.present and presence.rule.calls == STOP and presence.event is not None:
                label = presence.rule.label
                text = f"{presence.event.source} sees {label}: nothing approaches until it has left."
                return Reason(code=SCENE_NOT_CLEAR, text=text, fields={"label": label, "cause": INTRUSION})
        return None

    def _acts_now(self, rule: SceneRuleSettings) -> bool:
        """Return whether a rule stops now: a motion runs, or may run in the present states."""
        dispatcher = self._dispatcher
        if dispatcher.procedure.latched:
            return False
        joint = dispatcher.procedure.joint()
        in_states = all(joint.get(branch) in states for branch, states in rule.states.items())
        return dispatcher.moving or (in_states and self._may_move.now())

    def _takes_from_a_motion(self, call: Command) -> bool:
        """Return whether a motion may run, and an operation changes what motions require: it must not wait for one."""
        procedure = self._dispatcher.procedure
        if procedure.latched or not self._may_move.now():
            return False
        answer = procedure.ask(call.branch, call.operation)
        if isinstance(answer, Closure):
            return not self._may_move.required.isdisjoint(answer.writes)
        # It is rejected at once, unless a motion that runs takes its branch to a state that allows it.
        return self._dispatcher.moving and call.branch in self._may_move.required

    def _report(self, event: DeviceEvent, call: Command | None) -> None:
        """Report an event, and submit the operation that it calls; danger stops everything first."""
        if event.danger:
            self._dispatcher.begin_stop_for(event, lambda: [] if call is None else [self._dispatcher.admit(call)])
            return
        self._dispatcher.report_later(event)
        if call is not None:
            self._dispatcher.admit(call)


def _command(source: str, name: str, arguments: dict[str, Any]) -> Command:
    """Return the command by which a source calls an event operation, ``branch.operation``."""
    branch, _, operation = name.partition(".")
    return Command(
        id=f"scene-{uuid.uuid4().hex}",
        branch=branch,
        operation=operation,
        source=f"detector:{source}",
        user=DAEMON,
        role="daemon",
        arguments=arguments,
    )


class _MotionStates:
    """Joint states in which a motion may run: one could be requested, or an activity moves the robot.

    Attributes:
        required: Branches whose states some motion requires, and those that move the robot.
    """

    def __init__(self, dispatcher: Dispatcher[Any, Any]) -> None:
        self._dispatcher = dispatcher
        blueprint: Blueprint = dispatcher.procedure.blueprint
        self._acting = [
            (name, key)
            for name, branch in blueprint.branches.items()
            for key, spec in branch.operations.items()
            if spec.moves or spec.affects_patient
        ]
        self._moved = [
            (name, state)
            for name, branch in blueprint.branches.items()
            for state, activity in branch.activities.items()
            if activity.moves
        ]
        self.required = frozenset(name for name, _ in self._moved).union(
            *(
                {name} | blueprint.examined[name, key]
                for name, key in self._acting
                if blueprint.branches[name].operations[key].moves
            )
        )

    def now(self) -> bool:
        """Return whether a motion may run in the present states."""
        procedure = self._dispatcher.procedure
        joint = procedure.joint()
        return (
            self._dispatcher.moving
            or any(joint.get(branch) == state for branch, state in self._moved)
            or any(isinstance(procedure.ask(branch, key), Closure) for branch, key in self._acting)
        )
