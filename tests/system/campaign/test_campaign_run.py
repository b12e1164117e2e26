"""How a campaign runs: one fault's failure, hang or crash is its own, and the report says what was seen."""

from __future__ import annotations

import asyncio
import json
import re
from pathlib import Path

import msgspec
import pytest
from click.testing import CliRunner, Result

from pcmrs.cli import main
from pcmrs.errors import DeviceError
from pcmrs.testing.errors import Unmet
from pcmrs_lab.campaign import fault as registry
from pcmrs_lab.campaign.catalogue import choose
from pcmrs_lab.campaign.fault import Evidence, NotRun, fault
from pcmrs_lab.campaign.lab import Lab
from pcmrs_lab.campaign.needs import program
from pcmrs_lab.campaign.report import JSON_NAME, PAGE_NAME, CampaignReport, FaultResult
from pcmrs_lab.campaign.run import NO_INJECTION, run_campaign
from pcmrs_lab.campaign.sham import inject_unless_sham
from tests.system.campaign.answered import check_answered

ONCE = {"seen": 1}
NASTY = "<script>alert('B4')</script> & \"more\""


@pytest.fixture(autouse=True)
def _scripted(monkeypatch: pytest.MonkeyPatch) -> None:
    """Injections of which the outcome is known, in place of the real ones."""
    monkeypatch.setattr(registry, "REGISTERED", {})
    monkeypatch.setattr("pcmrs_lab.campaign.run.injections", lambda: registry.REGISTERED)
    monkeypatch.setattr("tests.system.campaign.answered.injections", lambda: registry.REGISTERED)

    @fault("S1", how="well")
    async def well(lab: Lab) -> Evidence:
        lab.folder.joinpath("left over").write_text("x")
        drawn = {"seed": lab.seed, "drawn": lab.random.random()}
        return Evidence("as required", took_place=ONCE, control=ONCE, details=drawn)

    @fault("S2", how="unmet")
    async def unmet(lab: Lab) -> Evidence:
        raise Unmet(f"It moved. {NASTY}")

    @fault("S3", how="no tool here")
    async def no_tool(lab: Lab) -> Evidence:
        raise NotRun("this machine has no moon")

    @fault("S4", how="a tool that nobody has", needs=(program("sh"), program("no-such-tool-anywhere")))
    async def missing(lab: Lab) -> Evidence:
        raise AssertionError("must not be run")

    @fault("S5", how="hangs", deadline=0.05)
    async def hangs(lab: Lab) -> Evidence:
        await asyncio.Event().wait()
        raise AssertionError

    @fault("S6", how="crashes")
    async def crashes(lab: Lab) -> Evidence:
        raise DeviceError("The daemon is gone.")

    @fault("S7", how="first way")
    async def first(lab: Lab) -> Evidence:
        return Evidence("seen", took_place=ONCE, control=ONCE)

    @fault("S7", how="second way")
    async def second(lab: Lab) -> Evidence:
        raise Unmet("not seen")

    @fault("S8", how="can be")
    async def can_be(lab: Lab) -> Evidence:
        return Evidence("seen", took_place=ONCE, control=ONCE)

    @fault("S8", how="cannot be")
    async def cannot_be(lab: Lab) -> Evidence:
        raise NotRun("no disk")

    @fault("S9", how="nothing measured")
    async def unmeasured(lab: Lab) -> Evidence:
        return Evidence("as required", took_place={}, control=ONCE)

    @fault("S10", how="measured, and there was nothing")
    async def measured(lab: Lab) -> Evidence:
        arrived: list[int] = []
        inject_unless_sham(lambda: arrived.append(1))
        return Evidence("as required", took_place={"arrived": len(arrived)}, control={**ONCE, "way_m": 0.1})

    @fault("S11", how="found out at once")
    async def found_out(lab: Lab) -> Evidence:
        arrived: list[int] = []
        inject_unless_sham(lambda: arrived.append(1))
        if not arrived:
            raise Unmet("Nothing arrived.")
        return Evidence("as required", took_place=ONCE, control=ONCE)

    @fault("S12", how="without a control")
    async def uncontrolled(lab: Lab) -> Evidence:
        return Evidence("as required", took_place=ONCE, control={"accepted": False, "way_m": float("nan")})

    @fault("S13", how="breaks without its fault")
    async def breaks(lab: Lab) -> Evidence:
        arrived: list[int] = []
        inject_unless_sham(lambda: arrived.append(1))
        return Evidence("as required", took_place={"arrived": arrived[0]}, control=ONCE)


IDS = [f"S{number}" for number in range(1, 9)]
OUTCOMES = ["passed", "failed", "not_run", "not_run", "failed", "failed", "failed", "not_run"]


async def campaign(ids: list[str], seeds: list[int], jobs: int = 1) -> CampaignReport:
    return await run_campaign(choose(ids=ids), seeds, jobs)


def of(report: CampaignReport, fault_id: str) -> FaultResult:
    return next(result for result in report.faults if result.id == fault_id)


@pytest.mark.parametrize("jobs", [1, 3, 20])
async def test_each_fault_has_its_outcome_in_catalogue_order(jobs: int) -> None:
    report = await campaign(IDS, [1], jobs)
    assert [result.id for result in report.faults] == IDS
    assert [result.outcome for result in report.faults] == OUTCOMES
    assert report.summary == {"sensor": {"passed": 1, "failed": 4, "not_proved": 0, "not_run": 3}}
    assert [result.id for result in report.failed] == ["S2", "S5", "S6", "S7"]


async def test_observed_response_is_reported() -> None:
    report = await campaign(IDS, [1])
    said = {result.id: result.response for result in report.faults}
    assert said["S2"] == f"It moved. {NASTY}"
    assert said["S3"] == "this machine has no moon"
    assert said["S4"] == "missing here: no-such-tool-anywhere; `make tools` installs what can be installed"
    assert said["S5"] == "not ended within 0.05 s"
    assert said["S6"] == "DeviceError: The daemon is gone."
    assert of(report, "S6").parts[0].details["where"].startswith("test_campaign_run.py:")


async def test_all_ways_of_a_fault_are_tried_and_one_failure_fails_it() -> None:
    report = await campaign(["S7", "S8"], [1])
    assert [[part.outcome for part in result.parts] for result in report.faults] == [
        ["passed", "failed"],
        ["passed", "not_run"],
    ]
    assert (of(report, "S7").response, of(report, "S7").how) == ("not seen", "first way; second way")


async def test_fault_without_an_injection_is_not_run() -> None:
    report = await campaign(["S14"], [1])
    assert [(result.outcome, result.response) for result in report.faults] == [("not_run", NO_INJECTION)]


async def test_response_without_measurement_or_control_is_not_proved() -> None:
    report = await campaign(["S9", "S10", "S12"], [1])
    assert [(result.outcome, result.response) for result in report.faults] == [
        ("not_proved", "There is no measurement that the fault took place."),
        ("passed", "as required"),
        ("not_proved", "The measurement of its control is of nothing: accepted, way_m."),
    ]
    assert [result.id for result in report.failed] == ["S9", "S12"]
    with pytest.raises(AssertionError, match="S9"):
        check_answered(report.faults[:1])


async def test_sham_campaign_fails_what_passes_or_breaks_without_fault() -> None:
    report = await run_campaign(choose(ids=["S1", "S10", "S11", "S13", "S3"]), [1], is_sham=True)
    found = {result.id: (result.outcome, result.response) for result in report.faults}
    assert found == {
        "S1": ("failed", "Without its fault it passed: as required"),
        "S10": ("passed", "The measurement that the fault took place is of nothing: arrived."),
        "S11": ("passed", "Nothing arrived."),
        "S13": ("failed", "Without its fault it failed: IndexError: list index out of range"),
        "S3": ("not_run", "this machine has no moon"),
    }
    assert report.sham
    again = await campaign(["S10", "S13"], [1])
    assert [result.outcome for result in again.faults] == ["passed", "passed"]


@pytest.mark.parametrize(("part", "ids"), [("1/2", ["S1", "S5"]), ("2/2", ["S3"]), ("3/3", ["S5"])])
def test_a_part_of_the_chosen_faults_is_run(part: str, ids: list[str]) -> None:
    ended = run_faults("--id", "S1", "--id", "S3", "--id", "S5", "--part", part, "--json")
    assert [entry["id"] for entry in json.loads(ended.stdout)["faults"]] == ids


async def test_every_fault_gets_every_seed_and_it_fixes_the_draws() -> None:
    report = await campaign(["S1"], [4, 2])
    again = await campaign(["S1"], [2])
    assert [result.seed for result in report.faults] == [4, 2]
    drawn = [result.parts[0].details["drawn"] for result in report.faults]
    assert drawn[1] == again.faults[0].parts[0].details["drawn"] != drawn[0]


@pytest.mark.parametrize("fault_id", ["S2", "S3", "S5", "S6", "S7", "S8"])
async def test_a_test_passes_for_no_fault_that_failed_or_was_not_run(fault_id: str) -> None:
    with pytest.raises(AssertionError, match=fault_id):
        check_answered((await campaign([fault_id], [1])).faults)


async def test_test_is_skipped_only_for_a_missing_need() -> None:
    check_answered((await campaign(["S1"], [1])).faults)
    with pytest.raises(pytest.skip.Exception, match="S4 missing: no no-such-tool-anywhere"):
        check_answered((await campaign(["S1", "S4"], [1])).faults)
    with pytest.raises(AssertionError, match="S2"):
        check_answered((await campaign(["S2", "S4"], [1])).faults)


def run_faults(*words: str) -> Result:
    return CliRunner().invoke(main, ["faults", "run", *words])


def test_report_is_written_as_json_and_as_self_contained_page(tmp_path: Path) -> None:
    folder = tmp_path / "new" / "report"
    ended = run_faults("--id", "S1", "--id", "S2", "--json", "-o", str(folder))
    assert ended.exit_code == 1
    written = json.loads((folder / JSON_NAME).read_text())
    assert json.loads(ended.stdout) == written
    keys = {"id", "class", "outcome", "how", "response", "seed", "seconds", "reference"}
    assert all(keys <= entry.keys() for entry in written["faults"])
    assert [entry["outcome"] for entry in written["faults"]] == ["passed", "failed"]
    page = (folder / PAGE_NAME).read_text()
    assert "<script" not in page
    assert "&lt;script&gt;" in page
    shown = re.findall(r'<input type="checkbox" id="(?:class|outcome)-(\w+)" checked>', page)
    assert shown == ["passed", "failed", "not_proved", "not_run", "sensor"]
    assert all(f"tr.{name} {{ display: none; }}" in page for name in shown)
    assert not {word for word in ("http:", "https:", "src=", "@import", "url(") if word in page}
    assert msgspec.json.decode((folder / JSON_NAME).read_bytes(), type=CampaignReport).summary


@pytest.mark.parametrize(
    ("words", "status"),
    [
        (("--id", "S1"), 0),
        (("--id", "S3"), 0),
        (("--id", "S2"), 1),
        (("--id", "Z1"), 2),
        (("--class", "weather"), 2),
        (("--seed", "-1"), 2),
        (("--jobs", "0"), 2),
        (("--part", "3/2"), 2),
        (("--part", "0/2"), 2),
        (("--id", "S1", "--sham"), 1),
        (("--id", "S11", "--sham"), 0),
        (("--id", "S9"), 1),
    ],
)
def test_the_exit_status_says_whether_a_response_was_missed(words: tuple[str, ...], status: int) -> None:
    assert run_faults(*words).exit_code == status


def test_the_table_names_outcome_and_reason() -> None:
    ended = run_faults("--id", "S1", "--id", "S3")
    assert "passed" in ended.stdout
    assert "this machine has no moon" in ended.stdout
