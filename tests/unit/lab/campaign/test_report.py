"""The report of a campaign: the worst part decides, each outcome is counted, and the page says all of it."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import pytest
from msgspec.structs import replace

from pcmrs_lab.campaign.catalogue import CLASSES, RESPONSES, choose
from pcmrs_lab.campaign.report import (
    JSON_NAME,
    MARKS,
    OUTCOMES,
    PAGE_NAME,
    CampaignReport,
    FaultResult,
    InjectionResult,
    Outcome,
    render_page,
    result_of,
    summarize,
    values,
    write_report,
)
from tests.unit.lab.campaign.scripted_faults import NASTY

ROW = choose(ids=["S1"])[0]
OTHER = choose(ids=["B1"])[0]


def part(outcome: Outcome, response: str = "seen", how: str = "by hand", **details: Any) -> InjectionResult:
    return InjectionResult("one", how, outcome, response, 1.5, details)


def result(outcome: Outcome, row: Any = ROW, **details: Any) -> FaultResult:
    return result_of(row, 1, [part(outcome, **details)])


def campaign(*results: FaultResult, sham: bool = False) -> CampaignReport:
    return CampaignReport(True, "1.0", [1], 60.0, list(results), summarize(list(results)), sham)


@pytest.mark.parametrize(
    ("parts", "outcome"),
    [
        (["passed", "passed"], "passed"),
        (["passed", "not_run"], "not_run"),
        (["not_run", "not_proved", "passed"], "not_proved"),
        (["passed", "not_proved", "failed", "not_run"], "failed"),
    ],
)
def test_the_worst_part_decides(parts: list[Outcome], outcome: Outcome) -> None:
    found = result_of(ROW, 3, [part(each, f"it {each}") for each in parts])
    assert (found.outcome, found.response, found.seed) == (outcome, f"it {outcome}", 3)
    assert found.seconds == 1.5 * len(parts)
    assert (found.id, found.required) == (ROW.id, ROW.required)


def test_what_parts_have_in_common_is_said_once() -> None:
    parts = [part("failed", "it moved"), part("failed", "it moved", "by a process"), part("failed", "late", "")]
    found = result_of(ROW, 1, parts)
    assert (found.response, found.how) == ("it moved; late", "by hand; by a process")


def test_each_outcome_is_counted_in_its_class() -> None:
    report = campaign(result("passed"), result("passed"), result("not_proved"), result("failed", OTHER))
    none = dict.fromkeys(OUTCOMES, 0)
    assert report.summary == {
        ROW.fault_class: {**none, "passed": 2, "not_proved": 1},
        OTHER.fault_class: {**none, "failed": 1},
    }
    assert list(report.summary) == [name for name in CLASSES if name in report.summary]
    assert [each.outcome for each in report.failed] == ["not_proved", "failed"], "what was not run has not failed"


def test_measured_values_are_shown_in_one_line() -> None:
    assert values({"way_m": 0.123456, "rows": 12, "refused_as": "busy", "latched": True}) == (
        "way m 0.1235, rows 12, refused as busy, latched True"
    )


def test_both_files_are_written_and_agree(tmp_path: Path) -> None:
    report = campaign(result("passed", way_m=0.1), result("not_run", OTHER))
    write_report(report, tmp_path)
    found = json.loads((tmp_path / JSON_NAME).read_bytes())
    assert [(each["id"], each["class"], each["outcome"]) for each in found["faults"]] == [
        (ROW.id, ROW.fault_class, "passed"),
        (OTHER.id, OTHER.fault_class, "not_run"),
    ]
    assert found["faults"][0]["parts"][0]["details"] == {"way_m": 0.1}
    assert (tmp_path / PAGE_NAME).read_text() == render_page(report)


def test_the_page_shows_every_result_with_its_mark() -> None:
    page = render_page(campaign(*(result(each, way_m=0.5) for each in OUTCOMES)))
    for outcome in OUTCOMES:
        assert f"{MARKS[outcome]} {ROW.id}</a>" in page
        assert f'<td class="mark {outcome}">{outcome.replace("_", " ")}</td>' in page
    assert page.count("way m 0.5") == len(OUTCOMES)
    assert all(meaning in page for meaning in RESPONSES.values())


@pytest.mark.parametrize("outcome", OUTCOMES)
@pytest.mark.parametrize("place", [".bar", ".cells", ".counts", "td"])
def test_every_outcome_has_a_colour(outcome: Outcome, place: str) -> None:
    style = render_page(campaign()).partition("</style>")[0]
    selector = f"{place}.{outcome}" if place == "td" else f"{place} .{outcome}"
    assert re.search(rf"{re.escape(selector)}[ ,]", style), "white on white is not seen"


def test_nothing_of_a_report_becomes_part_of_the_page() -> None:
    page = render_page(campaign(replace(result("failed", note=NASTY), response=NASTY, title=NASTY)))
    assert "<script" not in page
    assert page.count("&lt;script&gt;") == 4


def test_the_page_of_a_sham_campaign_says_so() -> None:
    assert "No fault was injected" in render_page(campaign(result("passed"), sham=True))
    assert "No fault was injected" not in render_page(campaign(result("passed")))
