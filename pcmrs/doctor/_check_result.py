"""The result of one check."""

from __future__ import annotations

from typing import Literal

from pcmrs.messages import Message

CheckVerdict = Literal["good", "warning", "bad"]


class CheckResult(Message, frozen=True, kw_only=True, omit_defaults=False):
    """Result of a check, and what to do about it.

    Attributes:
        check: Name of the check.
        verdict: ``warning``: the cell works, but something should be improved. ``bad``: it does not work, or
            cannot be relied on.
        found: The values, with their limits.
        remedy: Action to take; empty only if the verdict is good.
    """

    check: str
    verdict: CheckVerdict
    found: str
    remedy: str = ""


def good(check: str, found: str) -> CheckResult:
    """Return a finding that needs no action.

    Args:
        check: Name of the check.
        found: Values, with their limits.
    """
    return CheckResult(check=check, verdict="good", found=found)


def warning(check: str, found: str, remedy: str) -> CheckResult:
    """Return a finding with which the cell works.

    Args:
        check: Name of the check.
        found: Values, with their limits.
        remedy: What to do.
    """
    return CheckResult(check=check, verdict="warning", found=found, remedy=remedy)


def bad(check: str, found: str, remedy: str) -> CheckResult:
    """Return a finding with which the cell does not work.

    Args:
        check: Name of the check.
        found: Values, with their limits.
        remedy: What to do.
    """
    return CheckResult(check=check, verdict="bad", found=found, remedy=remedy)
