"""What is known of a simulated session at any moment: by what was published, journalled, moved, fired and answered."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from typing import Any

from pcmrs.fsm import Blueprint
from pcmrs.journal import JournalReader
from pcmrs.messages import Command, DeviceEvent, JointState, Snapshot, Verdict

PULSES = ("stimulation.fire", "hotspot.pulse", "threshold.pulse")
REGISTERING = ("register", "refine", "use_previous")
INSIDE = ("device:", "activity:")
"""Sources of what nobody has asked for."""
MOVING_SPEED = 1e-3
"""A joint that is slower than this stands, rad/s."""


def refuses_the_id(verdict: Verdict) -> bool:
    """Whether another command has that id: what was decided on that one stays as it is."""
    return verdict.reason is not None and verdict.reason.code == "id_reused"


@dataclass
class Since:
    """Whether something is so, and since when or until when it was, s."""

    holds: bool = False
    changed: float = float("-inf")

    def become(self, holds: bool, now: float) -> None:
        """It is so from now on, or not any more."""
        if holds != self.holds:
            self.holds, self.changed = holds, now

    def gone_for(self, now: float) -> float:
        """How long it has not been so, s."""
        return 0.0 if self.holds else now - self.changed


@dataclass
class View:
    """Everything that the invariants are about.

    Attributes:
        blueprint: Of the workflow.
        now: s of the simulation.
        run: Number of the daemon's run; 0 while there is none.
        snapshot: Published last in this run.
        before: The one before.
        motion: Something allows the arm to move.
        latch: Stop is latched.
        pulse: Something allows a pulse.
        calm: Nothing is wrong with network, hosts and robot.
        by_hand: Until then the arm is moved from outside, s.
        performed: Ids of commands on which a verdict that is no rejection was published.
        outcomes: Journalled verdicts by (source, id).
        by_id: The same by id alone, which is all that a published verdict has.
        accounts: Verdicts that operators got by (source, id).
        danger: The last event was danger, and no snapshot has been published since.
        needless: Rejected events of devices and activities that were journalled, although they have changed nothing.
        released: Journalled accepted verdicts that release the latch, which have not released it yet.
        excused: The daemon's disk has failed in this run: what it then refuses is not journalled.
        seen: How often what was seen, by names such as ``accepted placement.approach``.
    """

    blueprint: Blueprint
    now: float = 0.0
    run: int = 0
    snapshot: Snapshot | None = None
    before: Snapshot | None = None
    motion: Since = field(default_factory=Since)
    latch: Since = field(default_factory=Since)
    pulse: Since = field(default_factory=Since)
    calm: Since = field(default_factory=lambda: Since(True, 0.0))
    by_hand: float = float("-inf")
    performed: set[str] = field(default_factory=set)
    outcomes: dict[tuple[str, str], Verdict] = field(default_factory=dict)
    by_id: dict[str, Verdict] = field(default_factory=dict)
    accounts: dict[tuple[str, str], Verdict] = field(default_factory=dict)
    danger: bool = False
    needless: list[str] = field(default_factory=list)
    released: int = 0
    excused: bool = False
    seen: Counter[str] = field(default_factory=Counter)
    _made: bool = False
    _in_force: set[str] = field(default_factory=set)
    _rows: int = 0

    @property
    def registered(self) -> bool:
        """Whether the registration in force rests on a journalled accepted verdict of this run.

        It carries the id of the command that made it: by sequence numbers a Stop could come in between.
        """
        return self.snapshot is not None and self.snapshot.registration in self._in_force

    def begin_run(self) -> None:
        """A daemon has started: the latch of before and all states are gone, or as it says now."""
        self.run += 1
        self.snapshot = self.before = None
        self.excused = self.danger = False
        self.released = 0
        self._in_force = set()

    def end_run(self) -> None:
        """The daemon is gone: nothing allows anything any more."""
        self.motion.become(False, self.now)
        self.pulse.become(False, self.now)
        self.snapshot = self.before = None

    def take_snapshot(self, snapshot: Snapshot) -> None:
        """It was published."""
        self.before, self.snapshot = self.snapshot, snapshot
        running = [f"{each.branch}.{each.operation}" for each in snapshot.running]
        branches = snapshot.branches
        near = branches.get("placement") in ("placed", "following") and branches.get("stimulation") == "armed"
        self.latch.become(snapshot.latched, self.now)
        self.motion.become(self._allows_motion(snapshot) and not snapshot.latched, self.now)
        self.pulse.become(near and not snapshot.latched and any(name in PULSES for name in running), self.now)

    def take_rows(self, reader: JournalReader) -> None:
        """Reads what was journalled since."""
        for stored in reader.read(after=self._rows):
            row, self._rows = stored.row, stored.sequence
            if row.kind == "outcome" and row.verdict is not None:
                self.outcomes[row.source or "", row.command_id or ""] = row.verdict
                self.by_id[row.command_id or ""] = row.verdict
                self.released += self._releases(row.verdict)
                if self.is_rejected_event(row.verdict) and (row.source or "").startswith(INSIDE):
                    self.needless.append(f"{row.branch}.{row.operation}, which {row.source} has reported")
                if row.verdict.decision == "accepted" and row.branch == "registration":
                    self._take_registration(row.operation or "", row.command_id or "")

    def take_verdict(self, verdict: Verdict) -> None:
        """It was published."""
        self.seen[f"{verdict.decision} {verdict.branch}.{verdict.operation}"] += 1

    def _take_registration(self, operation: str, command: str) -> None:
        if operation not in REGISTERING or (operation == "use_previous" and not self._made):
            return
        self._made = True
        self._in_force.add(f"registration-{command}")

    def is_rejected_event(self, verdict: Verdict) -> bool:
        """Whether it rejects what is no command, but says what has happened."""
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
        """Of the fastest joint, rad/s."""
        return max(map(abs, self.state.velocities))


@dataclass(frozen=True, slots=True)
class Fired:
    """The stimulator has given a pulse."""

    number: int


@dataclass(frozen=True, slots=True)
class Answered:
    """A verdict has reached the operator who asked."""

    command: Command
    verdict: Verdict


Event = Snapshot | Verdict | DeviceEvent | Moved | Fired | Answered
Fields = dict[str, Any]
