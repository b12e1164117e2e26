"""What to do about an operation that was not accepted."""

from __future__ import annotations

from pcmrs.fsm import Blueprint
from pcmrs.messages import Verdict

ADVICE = {
    "bad_arguments": "Correct the arguments and ask again.",
    "busy": "Ask again when what is running has ended.",
    "daemon_ended": "Look where the robot is, and have it located again.",
    "deadline_passed": "Look whether the device answers, then ask again.",
    "event_operation": "Nothing: devices ask for it by themselves.",
    "expired": "Ask again; compare the clocks if it was sent just now.",
    "internal_operation": "Nothing: the workflow asks for it by itself.",
    "latched": "Acknowledge the Stop once its cause is gone, then ask again.",
    "lease_held": "Ask whoever holds the cell, or wait until they give it back.",
    "no_lease": "Take the lease of the cell first.",
    "queue_full": "Wait for the answers, then ask again.",
    "role_not_allowed": "Ask somebody whose role allows it.",
    "stopped": "Acknowledge the Stop once its cause is gone, then ask again.",
    "unknown_operation": "Correct the name.",
}
"""By code, where the reason itself does not say it."""
DOUBT = "Look at the patient and at the robot, then settle it: locate the arm after a motion, acknowledge otherwise."
WRONG_TIME = frozenset(
    {"busy", "event_operation", "internal_operation", "invalid_in_state", "latched", "queue_full", "stopped"}
)
"""Codes that say when or by whom something was asked for, not what was wrong with it."""
SHOWN = 4
"""So many of the operations that were possible are named."""


def advise(verdict: Verdict, blueprint: Blueprint | None) -> str:
    """What to do; empty where only the reason itself can say it.

    Args:
        verdict: That did not accept.
        blueprint: For the words of states; None where it is not known.
    """
    reason = verdict.reason
    code = "" if reason is None else reason.code
    if verdict.decision == "unknown":
        return DOUBT
    if code in ADVICE:
        return ADVICE[code]
    needed = {} if reason is None else reason.fields
    if isinstance(needed.get("needed"), list) and isinstance(needed.get("branch"), str):
        return f"First bring {_branch(needed['branch'], needed['needed'], blueprint)}."
    if code == "invalid_in_state" and verdict.allowed:
        more = ", …" if len(verdict.allowed) > SHOWN else ""
        return f"Possible was: {', '.join(verdict.allowed[:SHOWN])}{more}."
    return ""


def _branch(name: str, states: list[str], blueprint: Blueprint | None) -> str:
    """A branch and the states it is to be in, in the words of its workflow."""
    spec = None if blueprint is None else blueprint.branches.get(name)
    known = {} if spec is None else spec.states
    meant = " or ".join(f"“{known[state]}”" if known.get(state) else state for state in states)
    return f"{name} to {meant}"
