"""The finding of one check."""

from __future__ import annotations

from collections.abc import Iterator

from pcmrs.doctor import CheckResult


def only(findings: Iterator[CheckResult], check: str) -> CheckResult:
    (found,) = [finding for finding in findings if finding.check == check]
    assert bool(found.remedy) == (found.verdict != "good")
    return found
