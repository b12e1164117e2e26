"""A test that injects faults passes for none that failed or was not run, and is skipped only for what is missing."""

from __future__ import annotations

import pytest

from pcmrs_lab.campaign import fault as registry
from pcmrs_lab.campaign.catalogue import choose
from pcmrs_lab.campaign.report import FaultResult
from pcmrs_lab.campaign.run import run_campaign
from tests.system.lab.campaign.answered import check_answered
from tests.unit.lab.campaign.scripted_faults import register


@pytest.fixture(autouse=True)
def _scripted(monkeypatch: pytest.MonkeyPatch) -> None:
    register(monkeypatch)
    monkeypatch.setattr("tests.system.lab.campaign.answered.injections", lambda: registry.REGISTERED)


def results(*ids: str) -> list[FaultResult]:
    return (run_campaign(choose(ids=ids), [1])).faults


@pytest.mark.parametrize("fault_id", ["S2", "S3", "S5", "S6", "S7", "S8", "S9"])
def test_a_test_passes_for_no_fault_that_failed_or_was_not_run(fault_id: str) -> None:
    with pytest.raises(AssertionError, match=fault_id):
        check_answered(results(fault_id))


def test_test_is_skipped_only_for_a_missing_need() -> None:
    check_answered(results("S1"))
    with pytest.raises(pytest.skip.Exception, match="S4 missing: no no-such-tool-anywhere"):
        check_answered(results("S1", "S4"))
    with pytest.raises(AssertionError, match="S2"):
        check_answered(results("S2", "S4"))
