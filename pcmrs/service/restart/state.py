"""State that a run of the daemon takes over from the journal, updated with every row that is appended."""

from __future__ import annotations

from math import isfinite
from typing import Any

import msgspec

from pcmrs.dispatcher.events import ACTIVITY_ENDED, ACTIVITY_STARTED, NOT_CONFIRMED, SHUTDOWN
from pcmrs.dispatcher.recovery import PendingOutcomes
from pcmrs.fsm import Blueprint
from pcmrs.fsm.blueprint import OperationSpec
from pcmrs.journal import JournalRow
from pcmrs.journal.notes import RESTORED, SOURCE
from pcmrs.messages import Reason, UnknownOutcome

TAKEN_BACK = ("previous", "noise", "previous_digitization", "previous_plan")
"""Fields of the data that outlive a run of the daemon: those that only explicit operations use, after their checks, and
the measured noise of each pointer."""
INITIAL_JOINTS = "initial_joints"
"""Code of the event by which the gateway reports that the present posture is the initial one from now on."""
GATEWAY = "gateway"
"""Source of that event. Any device may use the same code."""
ACTIVITY = "activity:"
"""Begin of the source of events by which the dispatcher reports that an activity has begun or ended."""
ENDED = Reason(code="daemon_ended", text="The daemon ended while it ran; its outcome is unknown.")


class InFlightCommand(UnknownOutcome, frozen=True, kw_only=True, omit_defaults=False):
    """Command that has begun and not ended; `state` is that of its branch when it began."""

    state: str


class PersistedState(msgspec.Struct, frozen=True, kw_only=True):
    """State as a row of the journal stores it.

    Attributes:
        taken_back: Field of the procedure's data to its value.
        latched: The last Stop or danger was not acknowledged, or the cell was restored from a backup since; the Stop at
            the end of a daemon does not count.
        begun: Unfinished commands.
        moving: Unfinished activities that move the robot; `operation` is the name of the activity.
        unknown: Unknown outcomes that no operator has settled.
        initial_joints: Posture that was remembered last as the initial one, rad, (n,); empty for none.
    """

    taken_back: dict[str, Any] = {}
    latched: bool = False
    begun: tuple[InFlightCommand, ...] = ()
    moving: tuple[InFlightCommand, ...] = ()
    unknown: tuple[UnknownOutcome, ...] = ()
    initial_joints: tuple[float, ...] = ()


class RestartState:
    """State after the rows of a journal, in their order; it may begin at any row whose state is known.

    Args:
        blueprint: The workflow.
        kept: State at the row where it begins.
    """

    def __init__(self, blueprint: Blueprint, kept: PersistedState) -> None:
        self._blueprint = blueprint
        self._taken_back = dict(kept.taken_back)
        self._latched = kept.latched
        self._initial_joints = kept.initial_joints
        self._begun = {(each.source, each.command): each for each in kept.begun}
        self._moving = {(each.source, each.command): each for each in kept.moving}
        self._unsettled = PendingOutcomes(blueprint, kept.unknown)

    @property
    def kept(self) -> PersistedState:
        """Present state."""
        return PersistedState(
            taken_back=dict(self._taken_back),
            latched=self._latched,
            begun=tuple(self._begun.values()),
            moving=tuple(self._moving.values()),
            unknown=tuple(self._unsettled.shown()),
            initial_joints=self._initial_joints,
        )

    def take(self, row: JournalRow) -> None:
        """Follow one more row."""
        if row.kind == "intent":
            self._begin(row)
        elif row.kind == "outcome":
            self._end(row)
        elif row.kind == "config":
            self._leave_moving()
        elif row.kind == "event" and (row.source, row.operation) == (SOURCE, RESTORED):
            self._latched = True  # a Stop after the backup is not in this journal
        elif row.kind == "device":
            self._follow_activity(row)
            if (row.source, row.operation) == (GATEWAY, INITIAL_JOINTS):
                self._initial_joints = _joints_of(row) or self._initial_joints
            if (row.result or {}).get("danger"):
                self._latched = self._latched or row.source != SHUTDOWN or _left_unconfirmed(row)

    def _begin(self, row: JournalRow) -> None:
        source, command, branch = row.source or "", row.command_id or "", row.branch or ""
        self._begun[source, command] = InFlightCommand(
            command=command,
            source=source,
            branch=branch,
            operation=row.operation or "",
            since=row.wall,
            state=(row.states or {}).get(branch, ""),
        )

    def _end(self, row: JournalRow) -> None:
        began = self._begun.pop((row.source or "", row.command_id or ""), None)
        decision = row.verdict.decision if row.verdict is not None else None
        if decision == "accepted":
            self._accept(row)
        elif decision == "unknown":
            self._add_unknown_outcome(row, row.wall if began is None else began.since)

    def _follow_activity(self, row: JournalRow) -> None:
        """Follow an activity that moves the robot: it has begun, or ended with the robot at rest or a motion."""
        fields = (row.result or {}).get("fields") or {}
        key = row.source or "", str(fields.get("command", ""))
        if not key[0].startswith(ACTIVITY):
            return
        if row.operation == ACTIVITY_ENDED:
            self._moving.pop(key, None)
        elif row.operation == ACTIVITY_STARTED and self._moves(fields["branch"], fields["state"]):
            self._moving[key] = InFlightCommand(
                command=key[1],
                source=key[0],
                branch=fields["branch"],
                operation=key[0].partition(":")[2],
                since=row.wall,
                state=fields["state"],
            )

    def _leave_moving(self) -> None:
        """Treat activities that moved the robot when a daemon ended like unfinished motions."""
        for each in self._moving.values():
            self._latched = True
            self._unsettled.add(
                UnknownOutcome(
                    command=each.command,
                    source=each.source,
                    branch=each.branch,
                    operation=each.operation,
                    since=each.since,
                )
            )
        self._moving.clear()

    def _moves(self, branch: str, state: str) -> bool:
        """Return True if the activity of a state moves the robot, or if this version does not know the activity."""
        declared = self._blueprint.branches.get(branch)
        activity = None if declared is None else declared.activities.get(state)
        return activity is None or activity.moves

    def _accept(self, row: JournalRow) -> None:
        changes = row.result or {}
        self._taken_back |= {field: changes[field] for field in TAKEN_BACK if changes.get(field)}
        self._unsettled.settle_by(row.branch or "", row.operation or "")
        spec = self._spec(row)
        if self._latched and spec is not None and spec.unlatches:
            self._latched = False
            self._moving.clear()  # Stop has ended them all, even if the journal failed before it had the row

    def _add_unknown_outcome(self, row: JournalRow, since: float) -> None:
        self._unsettled.add(
            UnknownOutcome(
                command=row.command_id or "",
                source=row.source or "",
                branch=row.branch or "",
                operation=row.operation or "",
                since=since,
            )
        )
        spec, reason = self._spec(row), row.verdict.reason if row.verdict is not None else None
        if reason is not None and reason.code == ENDED.code and (spec is None or spec.blocked_when_latched):
            self._latched = True

    def _spec(self, row: JournalRow) -> OperationSpec | None:
        """Operation of a row; None if this version of the workflow does not have it."""
        branch = self._blueprint.branches.get(row.branch or "")
        return None if branch is None else branch.operations.get(row.operation or "")


def _joints_of(row: JournalRow) -> tuple[float, ...]:
    """Return the joints that an event reports, rad, (n,); empty if it has none that are finite numbers."""
    joints = ((row.result or {}).get("fields") or {}).get("joints")
    if not isinstance(joints, list) or not all(isinstance(each, (int, float)) and isfinite(each) for each in joints):
        return ()
    return tuple(float(each) for each in joints)


def _left_unconfirmed(row: JournalRow) -> bool:
    """Return True if a connected robot had not confirmed that it stood still when its daemon ended."""
    return row.operation == NOT_CONFIRMED and (row.states or {}).get("robot") == "1"
