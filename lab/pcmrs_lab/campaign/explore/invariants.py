"""Invariants that must hold after every event of a session under any fault; each with its source in the contract.

The numbers are those of docs/semantics.md, in which the meaning of the procedure is defined: 1 to 15.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

from pcmrs.errors import JournalError
from pcmrs.fsm.blueprint import Condition
from pcmrs.messages import DeviceEvent, Snapshot, Verdict
from pcmrs_lab.campaign.explore.view import MOVING_SPEED, Answered, Fired, Moved, ObservedEvent, View, refuses_the_id

BRAKED = 0.7
"""Time after which an arm that may not move stands if nothing else is wrong, s: brakes, and a report."""
BRAKED_ANYHOW = 6.0
"""Time after which it stands under any fault, s: an unanswered hold, then the deadman, then the brakes."""
LATE_PULSE = 1.5
"""Largest delay of a requested pulse, s: more than the deadman's time."""

AFTER_THE_STOP = ("hold_not_confirmed",)
"""Events that are published when a stop has ended: an operator may have acknowledged it by then."""

Invariant = Callable[[View, ObservedEvent], str | None]
"""Returns the description of a violation; None if it holds."""


def one_state_per_branch(view: View, event: ObservedEvent) -> str | None:
    """Check 2: every branch has exactly one active state, and 15: the flags mirror the states.

    Args:
        view: Knowledge of the session before the event.
        event: Event to check.

    Returns:
        Description of the violation; None if it holds.
    """
    if not isinstance(event, Snapshot):
        return None
    for name, branch in view.blueprint.branches.items():
        if event.branches.get(name) not in branch.states:
            return f"{name} is {event.branches.get(name)!r}, which is none of its states."
        for flag, digit in zip(branch.flags, event.branches[name], strict=False):
            if event.flags.get(flag) != (digit == "1"):
                return f"The flag {flag} does not mirror {name} {event.branches[name]}."
    return None


def children_fit_their_parents(view: View, event: ObservedEvent) -> str | None:
    """Check 12: a child branch is in a state that is compatible with that of its parent.

    Args:
        view: Knowledge of the session before the event.
        event: Event to check.

    Returns:
        Description of the violation; None if it holds.
    """
    if not isinstance(event, Snapshot):
        return None
    for name, branch in view.blueprint.branches.items():
        if branch.parent is None:
            continue
        fitting = branch.parent.compatible
        allowed = fitting.get(event.branches[name], fitting.get("*", []))
        if event.branches[branch.parent.branch] not in allowed:
            return f"{name} {event.branches[name]} does not fit {branch.parent.branch}'s state."
    return None


def promises_are_kept(view: View, event: ObservedEvent) -> str | None:
    """Check 1 and 3.2: the workflow's properties of states and running operations hold.

    Args:
        view: Knowledge of the session before the event.
        event: Event to check.

    Returns:
        Description of the violation; None if it holds.
    """
    if not isinstance(event, Snapshot):
        return None
    for promise in view.blueprint.properties:
        if promise.when.accepted or not _holds(promise.when, event):
            continue
        if promise.always is not None and not promise.always.accepted and not _holds(promise.always, event):
            return f"{promise.id} is broken: {promise.text}"
        if promise.never is not None and not promise.never.accepted and _holds(promise.never, event):
            return f"{promise.id} is broken: {promise.text}"
    return None


def nothing_moves_unasked(view: View, event: ObservedEvent) -> str | None:
    """Check 3.2: the arm moves only while a motion or an activity that moves it runs.

    Args:
        view: Knowledge of the session before the event.
        event: Event to check.

    Returns:
        Description of the violation; None if it holds.
    """
    if not isinstance(event, Moved) or event.speed < MOVING_SPEED or event.state.captured < view.by_hand:
        return None
    silent = view.motion.off_for(event.state.captured)
    if silent > braked(view):
        return f"The arm moves at {event.speed:.3f} rad/s, {silent:.2f} s after anything allowed it."
    return None


def stop_holds(view: View, event: ObservedEvent) -> str | None:
    """Check 7: Stop holds the robot and latches: no motion until it is acknowledged.

    Args:
        view: Knowledge of the session before the event.
        event: Event to check.

    Returns:
        Description of the violation; None if it holds.
    """
    if not isinstance(event, Moved) or event.speed < MOVING_SPEED or event.state.captured < view.by_hand:
        return None
    since = event.state.captured - view.latch.changed
    if view.latch.holds and since > braked(view):
        return f"The arm moves at {event.speed:.3f} rad/s, {since:.2f} s after Stop, which is not acknowledged."
    return None


def nothing_begins_while_latched(view: View, event: ObservedEvent) -> str | None:
    """Check 7: no motion begins until `robot.acknowledge`.

    Args:
        view: Knowledge of the session before the event.
        event: Event to check.

    Returns:
        Description of the violation; None if it holds.
    """
    if not isinstance(event, Snapshot) or not event.latched or view.before is None or not view.before.latched:
        return None
    known = {each.id for each in view.before.running}
    for each in event.running:
        spec = view.blueprint.branches[each.branch].operations[each.operation]
        if spec.blocked_when_latched and each.id not in known:
            return f"{each.branch}.{each.operation} has begun although Stop is latched."
    return None


def danger_latches(view: View, event: ObservedEvent) -> str | None:
    """Check 7: Stop, and device events that mean danger, latch at once.

    Args:
        view: Knowledge of the session before the event.
        event: Event to check.

    Returns:
        Description of the violation; None if it holds.
    """
    if isinstance(event, DeviceEvent) and event.danger and event.code not in AFTER_THE_STOP:
        view.danger = True
    if not isinstance(event, Snapshot) or not view.danger:
        return None
    view.danger = False
    return None if event.latched else "After a danger event the snapshot does not show Stop as latched."


def released_by_acknowledging(view: View, event: ObservedEvent) -> str | None:
    """Check 7: the latch stays until `robot.acknowledge`.

    Args:
        view: Knowledge of the session before the event.
        event: Event to check.

    Returns:
        Description of the violation; None if it holds.
    """
    if not isinstance(event, Snapshot) or view.before is None or not view.before.latched or event.latched:
        return None
    released, view.released = view.released, 0
    return None if released else "The latch is released without an acknowledgement."


def registered_by_a_verdict(view: View, event: ObservedEvent) -> str | None:
    """Check 3: registration 111 needs an accepted verdict on a residual within its limit, in the journal.

    Args:
        view: Knowledge of the session before the event.
        event: Event to check.

    Returns:
        Description of the violation; None if it holds.
    """
    if isinstance(event, Snapshot) and event.branches.get("registration") == "111" and not view.registered:
        return "The registration is 111, and the journal has no accepted verdict that led there."
    return None


def durable_before_known(view: View, event: ObservedEvent) -> str | None:
    """Check 13: the outcome is journalled before the reply and before it is published.

    Args:
        view: Knowledge of the session before the event.
        event: Event to check.

    Returns:
        Description of the violation; None if it holds.
    """
    if not isinstance(event, Verdict | Answered):
        return None
    verdict = event.verdict if isinstance(event, Answered) else event
    if refuses_the_id(verdict):
        return None
    if isinstance(event, Answered):
        journalled = view.outcomes.get((event.command.source, event.command.id))
    else:
        journalled = view.by_id.get(verdict.id)
    if journalled is not None and journalled.decision == verdict.decision:
        return None
    if journalled is None and view.is_rejected_event(verdict):
        return None  # a rejected event has no row, and no decision depends on it
    if view.excused and verdict.decision in ("rejected", "unknown"):
        return None
    how = "is not in the journal" if journalled is None else f"is {journalled.decision} in the journal"
    return f"{verdict.branch}.{verdict.operation} was reported as {verdict.decision}, but {how} ({verdict.id})."


def only_changes_leave_rows(view: View, _event: ObservedEvent) -> str | None:
    """Check 6: an event that the state does not allow is decided, and leaves no row."""
    return f"{view.needless_rows[0]}, was rejected, and journalled." if view.needless_rows else None


def timers_keep_their_time(view: View, _event: ObservedEvent) -> str | None:
    """Check 6: the event of a timer counts only while the timer runs, and when its time has passed."""
    return f"{view.early_timers[0]}, was accepted too early." if view.early_timers else None


def performed_once(view: View, event: ObservedEvent) -> str | None:
    """Check 14: a repeat of (source, id) runs nothing.

    Args:
        view: Knowledge of the session before the event.
        event: Event to check.

    Returns:
        Description of the violation; None if it holds.
    """
    if not isinstance(event, Verdict) or event.decision == "rejected":
        return None
    if event.decision == "unknown" and event.reason is not None and event.reason.code == JournalError.code:
        return None  # the journal failed in between: the outcome is published once the disk has been read again
    if event.id in view.performed:
        return f"{event.branch}.{event.operation} was performed twice for {event.id}."
    view.performed.add(event.id)
    return None


def repeats_get_the_recorded_verdict(view: View, event: ObservedEvent) -> str | None:
    """Check 14: a repeat returns the recorded decision.

    Args:
        view: Knowledge of the session before the event.
        event: Event to check.

    Returns:
        Description of the violation; None if it holds.
    """
    if not isinstance(event, Answered) or refuses_the_id(event.verdict):
        return None
    key = (event.command.source, event.command.id)
    first = view.accounts.setdefault(key, event.verdict)
    if first.decision != event.verdict.decision and not view.excused:
        return f"{key[1]} was reported as {first.decision} first, and as {event.verdict.decision} when it was repeated."
    return None


def sequence_never_goes_back(view: View, event: ObservedEvent) -> str | None:
    """Check 2: observers see commits in their order.

    Args:
        view: Knowledge of the session before the event.
        event: Event to check.

    Returns:
        Description of the violation; None if it holds.
    """
    if isinstance(event, Snapshot) and view.before is not None and event.sequence < view.before.sequence:
        return f"Snapshot {event.sequence} was published after {view.before.sequence}."
    return None


def rejection_changes_nothing(view: View, event: ObservedEvent) -> str | None:
    """Check 1 and 5: a rejection of any part leaves everything unchanged.

    Args:
        view: Knowledge of the session before the event.
        event: Event to check.

    Returns:
        Description of the violation; None if it holds.
    """
    if isinstance(event, Verdict) and event.decision == "rejected" and view.snapshot is not None:
        state = view.snapshot.branches.get(event.branch, event.state)
        if event.sequence == view.snapshot.sequence != 0:
            return None if state == event.state else f"{event.branch} is {event.state} by the rejection of {event.id}."
    return None


def fires_only_armed_and_placed(view: View, event: ObservedEvent) -> str | None:
    """Check 3.2: no stimulation unless the coil is placed and the stimulator armed for it.

    Args:
        view: Knowledge of the session before the event.
        event: Event to check.

    Returns:
        Description of the violation; None if it holds.
    """
    if isinstance(event, Fired) and view.pulse.off_for(view.now) > LATE_PULSE:
        return f"Pulse {event.number} was given although nothing allowed one."
    return None


def starts_with_nothing(view: View, event: ObservedEvent) -> str | None:
    """Check 13: after a restart all branches are initial.

    Args:
        view: Knowledge of the session before the event.
        event: Event to check.

    Returns:
        Description of the violation; None if it holds.
    """
    if isinstance(event, Snapshot) and view.before is None and event.branches != view.blueprint.initial():
        return f"The daemon has started in {event.branches}."
    return None


INVARIANTS: Mapping[type[ObservedEvent], tuple[Invariant, ...]] = {
    Snapshot: (
        one_state_per_branch,
        children_fit_their_parents,
        promises_are_kept,
        nothing_begins_while_latched,
        danger_latches,
        released_by_acknowledging,
        registered_by_a_verdict,
        sequence_never_goes_back,
        starts_with_nothing,
    ),
    Verdict: (
        durable_before_known,
        only_changes_leave_rows,
        timers_keep_their_time,
        performed_once,
        rejection_changes_nothing,
    ),
    DeviceEvent: (danger_latches,),
    Moved: (nothing_moves_unasked, stop_holds),
    Fired: (fires_only_armed_and_placed,),
    Answered: (durable_before_known, repeats_get_the_recorded_verdict),
}
"""Invariants by the type of event that can violate them."""


def _holds(condition: Condition, snapshot: Snapshot) -> bool:
    """Return whether states and running operations match a condition; what would be accepted is not checked."""
    running = {f"{each.branch}.{each.operation}" for each in snapshot.running}
    if condition.running and running.isdisjoint(condition.running):
        return False
    return all(snapshot.branches.get(branch) in states for branch, states in condition.states.items())


def braked(view: View) -> float:
    """Return the time within which the arm must stand when it may not move any more, s."""
    calm = view.calm.holds and view.calm.changed < view.now - BRAKED_ANYHOW
    return BRAKED if calm else BRAKED_ANYHOW
