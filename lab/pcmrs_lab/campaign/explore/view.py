"""Knowledge of a simulated session at any moment, from publications, journal, motions, pulses and answers."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from typing import Any

from pcmrs.dispatcher.events import TIMER_ENDED, TIMER_STARTED
from pcmrs.dispatcher.verdict_cache import ID_REUSED
from pcmrs.fsm import Blueprint
from pcmrs.journal import JournalReader, JournalRow
from pcmrs.messages import Command, DeviceEvent, JointState, Snapshot, Verdict

PULSES = ("stimulation.fire", "hotspot.pulse", "threshold.pulse")
REGISTERING = ("register", "refine", "use_previous")
INSIDE = ("device:", "activity:", "timer:")
"""Prefixes of the sources of commands that no client has requested."""
TIMER = "timer:"
"""Prefix of the sources of timers."""
ROUNDING = 1e-3
"""Largest difference of two readings of one clock that counts as none, s."""
MOVING_SPEED = 1e-3
"""Speed below which a joint stands, rad/s."""


def refuses_the_id(verdict: Verdict) -> bool:
    """Return whether the verdict says that another command has that id; the decision on that command is unchanged."""
    return verdict.reason is not None and verdict.reason.code == ID_REUSED


@dataclass
class TimedFlag:
    """Condition, with the time of its last change, s."""

    holds: bool = False
    changed: float = float("-inf")

    def set(self, holds: bool, now: float) -> None:
        """Set the condition.

        Args:
            holds: New value.
            now: Time of the simulation, s.
        """
        if holds != self.holds:
            self.holds, self.changed = holds, now

    def off_for(self, now: float) -> float:
        """Return for how long it has been false, s; 0 if it is true."""
        return 0.0 if self.holds else now - self.changed


@dataclass
class View:
    """Knowledge that the invariants need.

    Attributes:
        blueprint: Blueprint of the workflow.
        now: Time of the simulation, s.
        run: Number of the daemon's run; 0 if there is none.
        snapshot: Snapshot that was published last in this run.
        before: Snapshot before that.
        motion: True while something permits the arm to move.
        latch: True while Stop is latched.
        pulse: True while something permits a pulse.
        calm: True while network, hosts and robot have no fault.
        by_hand: Time until which the arm is moved from outside, s.
        performed: Ids of commands on which a verdict other than a rejection was published.
        outcomes: Journalled verdicts by (source, id).
        by_id: Journalled verdicts by id alone, which is all that a published verdict has.
        accounts: Verdicts that operators received by (source, id).
        danger: True if the last event was danger, and no snapshot has been published since.
        needless_rows: Rejected events that were journalled, although they have changed nothing.
        early_timers: Events of timers that were journalled as accepted, although the timer did not run or was not due.
        released: Number of journalled accepted verdicts that release the latch, which have not released it yet.
        excused: True if the daemon's disk has failed in this run: its later refusals are not journalled.
        seen: Number of decisions by names such as ``accepted placement.approach``.
    """

    blueprint: Blueprint
    now: float = 0.0
    run: int = 0
    snapshot: Snapshot | None = None
    before: Snapshot | None = None
    motion: TimedFlag = field(default_factory=TimedFlag)
    latch: TimedFlag = field(default_factory=TimedFlag)
    pulse: TimedFlag = field(default_factory=TimedFlag)
    calm: TimedFlag = field(default_factory=lambda: TimedFlag(True, 0.0))
    by_hand: float = float("-inf")
    performed: set[str] = field(default_factory=set)
    outcomes: dict[tuple[str, str], Verdict] = field(default_factory=dict)
    by_id: dict[str, Verdict] = field(default_factory=dict)
    accounts: dict[tuple[str, str], Verdict] = field(default_factory=dict)
    danger: bool = False
    needless_rows: list[str] = field(default_factory=list)
    early_timers: list[str] = field(default_factory=list)
    released: int = 0
    excused: bool = False
    seen: Counter[str] = field(default_factory=Counter)
    _has_registered: bool = False
    _in_force: set[str] = field(default_factory=set)
    _due: dict[str, float] = field(default_factory=dict)
    _rows: int = 0

    @property
    def registered(self) -> bool:
        """True if the registration in force has a journalled accepted verdict of this run.

        It carries the id of the command that made it: between sequence numbers a Stop could come.
        """
        return self.snapshot is not None and self.snapshot.registration in self._in_force

    def begin_run(self) -> None:
        """Begin a run: a started daemon has dropped the old latch and all states, or reports them itself."""
        self.run += 1
        self.snapshot = self.before = None
        self.excused = self.danger = False
        self.released = 0
        self._in_force = set()
        self._due = {}

    def end_run(self) -> None:
        """End a run: without a daemon nothing is permitted any more."""
        self.motion.set(False, self.now)
        self.pulse.set(False, self.now)
        self.snapshot = self.before = None

    def take_snapshot(self, snapshot: Snapshot) -> None:
        """Record a published snapshot."""
        self.before, self.snapshot = self.snapshot, snapshot
        running = [f"{each.branch}.{each.operation}" for each in snapshot.running]
        branches = snapshot.branches
        near = branches.get("placement") in ("placed", "following") and branches.get("stimulation") == "armed"
        self.latch.set(snapshot.latched, self.now)
        self.motion.set(self._allows_motion(snapshot) and not snapshot.latched, self.now)
        self.pulse.set(near and not snapshot.latched and any(name in PULSES for name in running), self.now)

    def take_rows(self, reader: JournalReader) -> None:
        """Read the rows that were journalled since the last call."""
        for stored in reader.read(after=self._rows):
            row, self._rows = stored.row, stored.sequence
            self._take_timer(row)
            if row.kind == "outcome" and row.verdict is not None:
                self.outcomes[row.source or "", row.command_id or ""] = row.verdict
                self.by_id[row.command_id or ""] = row.verdict
                self.released += self._releases(row.verdict)
                if self.is_rejected_event(row.verdict) and (row.source or "").startswith(INSIDE):
                    self.needless_rows.append(f"{row.branch}.{row.operation}, which {row.source} has reported")
                if row.verdict.decision == "accepted" and row.branch == "registration":
                    self._take_registration(row.operation or "", row.command_id or "")

    def take_verdict(self, verdict: Verdict) -> None:
        """Record a published verdict."""
        self.seen[f"{verdict.decision} {verdict.branch}.{verdict.operation}"] += 1

    def _take_timer(self, row: JournalRow) -> None:
        """Follow when timers begin and end, and note an event that one has posted too early.

        An event with steps may have started before its timer was restarted.
        """
        source = row.source or ""
        if not source.startswith(TIMER):
            return
        if row.kind == "device" and row.operation == TIMER_STARTED:
            self._due[source] = row.monotonic + float((row.result or {})["fields"]["after"])
        elif row.kind == "device" and row.operation == TIMER_ENDED:
            self._due.pop(source, None)
        elif row.kind == "outcome" and row.verdict is not None and row.verdict.decision == "accepted":
            spec, due = self.blueprint.find(row.branch or "", row.operation or ""), self._due.get(source)
            if (due is None or row.monotonic < due - ROUNDING) and not (spec is not None and spec.steps):
                self.early_timers.append(f"{row.branch}.{row.operation}, which {source} has posted")

    def _take_registration(self, operation: str, command: str) -> None:
        if operation not in REGISTERING or (operation == "use_previous" and not self._has_registered):
            return
        self._has_registered = True
        self._in_force.add(f"registration-{command}")

    def is_rejected_event(self, verdict: Verdict) -> bool:
        """Return whether a verdict rejects the operation of an event."""
        spec = self.blueprint.find(verdict.branch, verdict.operation)
        return spec is not None and spec.event and verdict.decision == "rejected"

    def _releases(self, verdict: Verdict) -> bool:
        spec = self.blueprint.branches[verdict.branch].operations.get(verdict.operation) if verdict.state else None
        return spec is not None and spec.unlatches and verdict.decision == "accepted"

    def _allows_motion(self, snapshot: Snapshot) -> bool:
        branches = self.blueprint.branches
        if any(branches[each.branch].operations[each.operation].moves for each in snapshot.running):
            return True
        ongoing = (branches[each.branch].activities.get(each.state) for each in snapshot.activities)
        return any(spec is not None and spec.moves for spec in ongoing)


@dataclass(frozen=True, slots=True)
class Moved:
    """The arm has reported its joints."""

    state: JointState

    @property
    def speed(self) -> float:
        """Speed of the fastest joint, rad/s."""
        return max(map(abs, self.state.velocities))


@dataclass(frozen=True, slots=True)
class Fired:
    """The stimulator has given a pulse."""

    number: int


@dataclass(frozen=True, slots=True)
class Answered:
    """A verdict has reached the operator who sent the command."""

    command: Command
    verdict: Verdict


ObservedEvent = Snapshot | Verdict | DeviceEvent | Moved | Fired | Answered
Fields = dict[str, Any]
