"""How a campaign runs: one fault's failure, hang or crash is its own, and the report says what was seen."""

from __future__ import annotations

from pathlib import Path

import pytest

from pcmrs_lab.campaign.catalogue import choose
from pcmrs_lab.campaign.report import CampaignReport, FaultResult
from pcmrs_lab.campaign.run import NO_INJECTION, run_campaign
from tests.unit.lab.campaign.scripted_faults import NASTY, register


@pytest.fixture(autouse=True)
def _scripted(monkeypatch: pytest.MonkeyPatch) -> None:
    register(monkeypatch)


IDS = [f"S{number}" for number in range(1, 9)]
OUTCOMES = ["passed", "failed", "not_run", "not_run", "failed", "failed", "failed", "not_run"]


def campaign(ids: list[str], seeds: list[int]) -> CampaignReport:
    return run_campaign(choose(ids=ids), seeds)


def of(report: CampaignReport, fault_id: str) -> FaultResult:
    return next(result for result in report.faults if result.id == fault_id)


def test_each_fault_has_its_outcome_in_catalogue_order() -> None:
    report = campaign(IDS, [1])
    assert [result.id for result in report.faults] == IDS
    assert [result.outcome for result in report.faults] == OUTCOMES
    assert report.summary == {"sensor": {"passed": 1, "failed": 4, "not_proved": 0, "not_run": 3}}
    assert [result.id for result in report.failed] == ["S2", "S5", "S6", "S7"]


def test_observed_response_is_reported() -> None:
    report = campaign(IDS, [1])
    said = {result.id: result.response for result in report.faults}
    assert said["S2"] == f"It moved. {NASTY}"
    assert said["S3"] == "this machine has no moon"
    assert said["S4"] == "missing here: no-such-tool-anywhere; `make tools` installs what can be installed"
    assert said["S5"] == "not ended within 0.05 s"
    assert said["S6"] == "DeviceError: The daemon is gone."
    assert of(report, "S6").parts[0].details["where"].startswith("scripted_faults.py:")


def test_all_ways_of_a_fault_are_tried_and_one_failure_fails_it() -> None:
    report = campaign(["S7", "S8"], [1])
    assert [[part.outcome for part in result.parts] for result in report.faults] == [
        ["passed", "failed"],
        ["passed", "not_run"],
    ]
    assert (of(report, "S7").response, of(report, "S7").how) == ("not seen", "first way; second way")


def test_fault_without_an_injection_is_not_run() -> None:
    report = campaign(["S14"], [1])
    assert [(result.outcome, result.response) for result in report.faults] == [("not_run", NO_INJECTION)]


def test_response_without_measurement_or_control_is_not_proved() -> None:
    report = campaign(["S9", "S10", "S12"], [1])
    assert [(result.outcome, result.response) for result in report.faults] == [
        ("not_proved", "There is no measurement that the fault took place."),
        ("passed", "as required"),
        ("not_proved", "The measurement of its control is of nothing: accepted, way_m."),
    ]
    assert [result.id for result in report.failed] == ["S9", "S12"]


def test_control_by_other_input_proves_nothing_against_attackers() -> None:
    report = campaign(["A1", "S1"], [1])
    assert [(result.outcome, result.id) for result in report.faults] == [("passed", "S1"), ("not_proved", "A1")]
    assert "or a mutant without the guard" in report.failed[0].response


def test_sham_campaign_fails_what_passes_or_breaks_without_fault() -> None:
    report = run_campaign(choose(ids=["S1", "S2", "S10", "S11", "S13", "S3"]), [1], is_sham=True)
    found = {result.id: (result.outcome, result.response) for result in report.faults}
    assert found == {
        "S1": ("failed", "Without its fault it passed: as required"),
        "S10": ("passed", "The measurement that the fault took place is of nothing: arrived."),
        "S11": ("passed", "Nothing arrived."),
        "S13": ("failed", "Without its fault it failed: IndexError: list index out of range"),
        "S2": ("failed", f"Before its fault it failed: It moved. {NASTY}"),
        "S3": ("not_run", "this machine has no moon"),
    }
    assert report.sham
    again = campaign(["S10", "S13"], [1])
    assert [result.outcome for result in again.faults] == ["passed", "passed"]


def test_every_fault_gets_every_seed_and_it_fixes_the_draws() -> None:
    report = campaign(["S1"], [4, 2])
    again = campaign(["S1"], [2])
    assert [result.seed for result in report.faults] == [4, 2]
    drawn = [result.parts[0].details["drawn"] for result in report.faults]
    assert drawn[1] == again.faults[0].parts[0].details["drawn"] != drawn[0]


def test_nothing_of_an_injection_is_left_behind(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    campaign(["S1", "S6"], [1])
    assert list(tmp_path.iterdir()) == []


def test_a_campaign_of_no_rows_has_an_empty_report() -> None:
    report = run_campaign([], [1])
    assert (report.faults, report.summary, report.failed) == ([], {}, [])


def test_attack_that_is_declared_but_not_tried_is_not_proved() -> None:
    """Otherwise the table of attacks would show one that never took place."""
    report = campaign(["A2", "A3"], [1])
    assert [(result.outcome, result.response) for result in report.faults] == [
        ("not_proved", "Declared, but not tried: TCP by viewer."),
        ("passed", "seen"),
    ]
    assert of(report, "A3").parts[0].details["tried"] == ["UDP by flood"]
    assert [result.id for result in report.failed] == ["A2"]


def test_sham_campaign_compares_no_attacks() -> None:
    """It would pass every row, whether the row detects that its fault is missing or not."""
    report = run_campaign(choose(ids=["A3"]), [1], is_sham=True)
    assert of(report, "A3").response == "Without its fault it passed: seen"
