"""A power cut at any instant loses no row that was acknowledged, and leaves a journal that is taken up."""

from __future__ import annotations

import pytest

from pcmrs.clock import SystemClock
from pcmrs_lab.campaign.cuts import CutReport, cut_power
from pcmrs_lab.campaign.syscall_trace import NEEDS

pytestmark = pytest.mark.skipif(not all(need.is_met() for need in NEEDS), reason="strace records what is written")


def found(times: int, seed: int, *, commits: int = 48, durable: bool = True) -> CutReport:
    return cut_power(times, seed, SystemClock(), commits=commits, durable=durable)


def test_a_power_cut_loses_no_acknowledged_row() -> None:
    report = found(60, 1)
    assert (report.tried, report.unaffected, report.lost, report.broken) == (60, 60, 0, [])
    assert report.acknowledged > 60


def test_power_cuts_expose_a_journal_that_does_not_wait_for_disk() -> None:
    report = found(20, 1, durable=False)
    assert report.violated
    assert report.tried - report.unaffected > 5


@pytest.mark.nightly
@pytest.mark.timeout(1200)
@pytest.mark.parametrize("seed", range(4))
def test_a_thousand_power_cuts_lose_no_acknowledged_row(seed: int) -> None:
    """Of a journal so long that its log is taken into the database while it is written."""
    report = found(250, seed, commits=600)
    assert (report.tried, report.lost, report.broken) == (250, 0, [])
