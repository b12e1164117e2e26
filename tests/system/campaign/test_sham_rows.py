"""Ten rows of the catalogue whose faults do not take place: each must find that by itself; nightly does it with all."""

from __future__ import annotations

import pytest

from pcmrs_lab.campaign.catalogue import catalogue
from pcmrs_lab.campaign.run import run_campaign

pytest.importorskip("mujoco")

TEN = ("O2", "O5", "O8", "O10", "C4", "A5", "A6", "A7", "B10", "Q4")
"""Of the classes operator, clock, adversary, robot and order; most share one daemon."""


@pytest.mark.timeout(300)
async def test_no_row_passes_without_its_fault() -> None:
    report = await run_campaign([catalogue()[row] for row in TEN], [1], is_sham=True)
    passed = [found.id for found in report.faults if found.outcome == "passed"]
    assert passed == list(TEN), [(found.id, found.response) for found in report.faults if found.outcome != "passed"]
