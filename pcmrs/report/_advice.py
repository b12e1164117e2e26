"""Advice for an operation that was not accepted."""

from __future__ import annotations

from pcmrs.fsm import Blueprint
from pcmrs.messages import Verdict

ADVICE = {
    "bad_arguments": "Correct the arguments and try again.",
    "busy": "Try again after the running operation has ended.",
    "daemon_ended": "Check where the robot is, and locate it again.",
    "deadline_passed": "Check whether the device answers, then try again.",
    "event_operation": "None: devices request it themselves.",
    "expired": "Try again; compare the clocks if it was sent just now.",
    "internal_operation": "None: the workflow requests it itself.",
    "latched": "Remove the cause of the Stop, acknowledge the Stop, then try again.",
    "lease_held": "Ask the holder of the cell, or wait until they release it.",
    "no_lease": "Take the lease of the cell first.",
    "queue_full": "Wait for the answers, then try again.",
    "role_not_allowed": "Ask a user whose role allows it.",
    "stopped": "Remove the cause of the Stop, acknowledge the Stop, then try again.",
    "unknown_operation": "Correct the name.",
}
"""Advice by code, for reasons that do not contain it."""
DOUBT = "Check the patient and the robot, then settle it: locate the arm after a motion, acknowledge otherwise."
WRONG_TIME = frozenset(
    {"busy", "event_operation", "internal_operation", "invalid_in_state", "latched", "queue_full", "stopped"}
)
"""Codes of commands that came at a wrong time or from a wrong sender, and were not checked further."""
MOST_NAMED = 4
"""Largest number of allowed operations that are named."""


def advise(verdict: Verdict, blueprint: Blueprint | None) -> str:
    """Return what to do; empty if only the reason itself can say it.

    Args:
        verdict: Verdict that did not accept.
        blueprint: Workflow with the meanings of states; None if it is unknown.
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
        more = ", …" if len(verdict.allowed) > MOST_NAMED else ""
        return f"Allowed then: {', '.join(verdict.allowed[:MOST_NAMED])}{more}."
    return ""


def _branch(name: str, states: list[str], blueprint: Blueprint | None) -> str:
    """Return a branch and its required states, in the words of its workflow."""
    spec = None if blueprint is None else blueprint.branches.get(name)
    known = {} if spec is None else spec.states
    meant = " or ".join(f"“{known[state]}”" if known.get(state) else state for state in states)
    return f"{name} to {meant}"
