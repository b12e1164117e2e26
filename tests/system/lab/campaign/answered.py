"""What must have come of faults: a test that injects them passes for none that was not run."""

from __future__ import annotations

from collections.abc import Sequence

import pytest

from pcmrs_lab.campaign.injections import injections
from pcmrs_lab.campaign.report import FaultResult


def check_answered(results: Sequence[FaultResult]) -> None:
    """Every fault has passed in all ways; where one lacks what it needs, and all else has passed, the test is skipped.

    Raises:
        AssertionError: One has failed, was not proved, or was not run though the machine has all that it needs.
    """
    lacking = [(result, _lacking(result)) for result in results]
    wrong = [
        (result.id, result.seed, part.name, part.outcome, part.response)
        for result, missing in lacking
        for part in result.parts
        if part.outcome != "passed" and not (part.outcome == "not_run" and missing.get(part.name))
    ]
    assert not wrong, wrong
    left_out = [
        f"{result.id} {name}: no {', '.join(needs)}" for result, missing in lacking for name, needs in missing.items()
    ]
    if left_out:
        pytest.skip("; ".join(left_out))


def _lacking(result: FaultResult) -> dict[str, list[str]]:
    """Name of a way to what it needs and this machine does not have; only ways that lack something."""
    ways = injections().get(result.id, [])
    missing = {way.name: [need.name for need in way.needs if not need.is_met()] for way in ways}
    return {name: needs for name, needs in missing.items() if needs}
