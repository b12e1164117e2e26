"""One thing that was looked at."""

from __future__ import annotations

from typing import Literal

from pcmrs.messages import Message

Verdict = Literal["good", "warning", "bad"]


class Finding(Message, frozen=True, kw_only=True, omit_defaults=False):
    """What was found, and what to do about it.

    Attributes:
        check: Which check.
        verdict: ``warning``: the cell works, and something is worse than it could be. ``bad``: it does not work, or
            cannot be relied on.
        found: The values, with their limits.
        remedy: What to do; empty only when it is good.
    """

    check: str
    verdict: Verdict
    found: str
    remedy: str = ""


def good(check: str, found: str) -> Finding:
    """A finding that needs nothing done."""
    return Finding(check=check, verdict="good", found=found)


def warning(check: str, found: str, remedy: str) -> Finding:
    """A finding with which the cell works."""
    return Finding(check=check, verdict="warning", found=found, remedy=remedy)


def bad(check: str, found: str, remedy: str) -> Finding:
    """A finding with which it does not."""
    return Finding(check=check, verdict="bad", found=found, remedy=remedy)
