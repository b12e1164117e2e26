"""Events that the dispatcher itself publishes and journals, beside its verdicts."""

from __future__ import annotations

from collections.abc import Mapping

from pcmrs.messages import DeviceEvent, Reason

DAEMON = "daemon"
"""Source of the daemon's reports about itself."""
SHUTDOWN = "shutdown"
"""Source of the Stop of an orderly shutdown: it need not be acknowledged."""
FAIL_STOP = "fail_stop"
"""Code of the event that nothing is accepted any more; its field ``reason`` is the code of why."""
NOT_CONFIRMED = "hold_not_confirmed"
"""Code of the event that it is unknown whether the robot stands."""
PRESSED_AGAIN = "stop_pressed_again"
"""Code of the event that counts the presses that have joined a pending Stop."""
ACTIVITY_STARTED, ACTIVITY_ENDED = "activity_started", "activity_ended"
"""Codes of the events that an activity is about to start, and that it has ended. The journal has the first before the
activity moves anything, and the second after the robot stands or a motion has taken over."""
REOPENED = DeviceEvent(
    device="journal",
    code="journal_reopened",
    text="The journal can be written again: look at the cell, then acknowledge.",
    danger=True,
)


def stopped(source: str, reason: Reason, number: int) -> DeviceEvent:
    """Event that everything was stopped.

    Args:
        source: Who has stopped.
        reason: Why.
        number: Number of the Stop.
    """
    fields = {**reason.fields, "stop": number}
    return DeviceEvent(device=source, code=reason.code, text=reason.text, danger=True, fields=fields)


def pressed_again(source: str, number: int, joined: Mapping[str, int]) -> DeviceEvent:
    """Event that a Stop was pressed again while it was pending.

    Args:
        source: Who has stopped first.
        number: Number of the Stop.
        joined: Number of further presses of each source.
    """
    presses = sum(joined.values())
    text = f"Stop {number} was pressed {presses} more times before the robot stood, by {len(joined)} sources."
    fields = {"stop": number, "presses": presses, "by": dict(joined)}
    return DeviceEvent(device=source, code=PRESSED_AGAIN, text=text, fields=fields)


def failed(reason: Reason) -> DeviceEvent:
    """Event that the dispatcher accepts nothing any more."""
    return DeviceEvent(device=DAEMON, code=FAIL_STOP, text=reason.text, danger=True, fields={"reason": reason.code})


def not_confirmed(source: str) -> DeviceEvent:
    """Event that robot or stimulator have not confirmed that they are stopped, as `source` has requested."""
    text = "Robot or stimulator have not confirmed that they are stopped: look, and use their own emergency stop."
    return DeviceEvent(device=source, code=NOT_CONFIRMED, text=text, danger=True)
