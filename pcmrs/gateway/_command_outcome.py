"""Outcome of a command, and the replies that report it to clients.

Verdict reply: ``<id>_accepted_<branch>_<state>[_<number>...];`` or ``<id>_rejected_<branch>_<state>_<reason>;`` or the
same with ``failed``. ``_`` inside a branch or state is written ``-``; the reason is everything after the fourth
separator and may itself hold ``_``. An unknown outcome is ``failed`` with the reason ``outcome_unknown``.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Literal

from pcmrs.errors import UnknownOutcomeError
from pcmrs.gateway.commands import Second
from pcmrs.messages import Verdict

NO_DATA = "no_data_returned;"


@dataclass(frozen=True, slots=True)
class CommandOutcome:
    """Outcome of a command.

    Attributes:
        reason: Code of the reason; None if accepted.
        numbers: Results in the units of the wire.
    """

    decision: Literal["accepted", "rejected", "failed"]
    branch: str
    state: str
    reason: str | None = None
    numbers: tuple[float, ...] = ()

    def reply(self, client_id: str) -> str:
        """Return the verdict reply to the command `client_id`."""
        head = [client_id, self.decision, self.branch.replace("_", "-"), self.state.replace("_", "-")]
        tail = [self.reason] if self.reason else [f"{number:.6g}" for number in self.numbers]
        return "_".join([*head, *tail]) + ";"

    def second(self, kind: Second) -> str:
        """Return the second datagram for clients without verdict replies: numbers if accepted."""
        if self.decision != "accepted" or not self.numbers:
            return NO_DATA
        if kind is Second.RESIDUAL:
            return f"{self.numbers[0]:.6f}"
        return "".join(f"{number:.6f}_" for number in self.numbers)


def of_verdict(verdict: Verdict) -> CommandOutcome:
    """Return the outcome of a dispatcher's verdict."""
    if verdict.decision == "accepted":
        return CommandOutcome("accepted", verdict.branch, verdict.state, numbers=_numbers(verdict.result or {}))
    if verdict.decision == "unknown":
        return CommandOutcome("failed", verdict.branch, verdict.state, UnknownOutcomeError.code)
    code = verdict.reason.code if verdict.reason else verdict.decision
    return CommandOutcome(verdict.decision, verdict.branch, verdict.state, code)


def _numbers(result: dict[str, Any]) -> tuple[float, ...]:
    """Residual in mm; or the measured pose (m, ``xyzw``, image) with its errors in mm and degrees."""
    if "residual" in result:
        return (result["residual"] * 1e3,)
    if "measured" in result:
        measured = result["measured"]
        errors = (result["translation_error"] * 1e3, math.degrees(result["rotation_error"]))
        return (*measured["position"], *measured["quat_xyzw"], *errors)
    return ()
