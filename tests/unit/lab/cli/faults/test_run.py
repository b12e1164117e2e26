"""`pcmrs faults run`: exit statuses, parts of a campaign, and its report on screen, as JSON and as a page."""

from __future__ import annotations

import json
import re
from pathlib import Path

import msgspec
import pytest
from click.testing import CliRunner, Result

from pcmrs.cli import main
from pcmrs_lab.campaign.report import JSON_NAME, PAGE_NAME, CampaignReport
from tests.unit.lab.campaign.scripted_faults import register


@pytest.fixture(autouse=True)
def _scripted(monkeypatch: pytest.MonkeyPatch) -> None:
    register(monkeypatch)


def run_faults(*words: str) -> Result:
    return CliRunner().invoke(main, ["faults", "run", *words])


@pytest.mark.parametrize(("part", "ids"), [("1/2", ["S1", "S5"]), ("2/2", ["S3"]), ("3/3", ["S5"])])
def test_a_part_of_the_chosen_faults_is_run(part: str, ids: list[str]) -> None:
    ended = run_faults("--id", "S1", "--id", "S3", "--id", "S5", "--part", part, "--json")
    assert [entry["id"] for entry in json.loads(ended.stdout)["faults"]] == ids


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
        (("--workers", "0"), 2),
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


def test_a_seed_that_is_given_twice_is_run_once() -> None:
    report = json.loads(run_faults("--id", "S1", "--seed", "3", "--seed", "2", "--seed", "3", "--json").stdout)
    assert report["seeds"] == [3, 2]
    assert [entry["seed"] for entry in report["faults"]] == [3, 2]


def test_a_sham_campaign_cannot_be_taken_for_a_real_one() -> None:
    ended = run_faults("--id", "S11", "--sham")
    assert "Sham campaign (no fault is injected)" in ended.stdout
    assert "Nothing arrived." in ended.stdout
