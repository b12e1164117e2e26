"""The report of a campaign as files: JSON for programs, one page of HTML for people."""

from __future__ import annotations

from pathlib import Path

import msgspec

from pcmrs.pages import render
from pcmrs_lab.campaign.catalogue import RESPONSES
from pcmrs_lab.campaign.report import OUTCOMES, CampaignReport

JSON_NAME = "faults.json"
PAGE_NAME = "faults.html"
TEMPLATE = "faults.html.j2"
MARKS = {"passed": "✓", "failed": "✗", "not_proved": "?", "not_run": "–"}


def write_report(report: CampaignReport, folder: Path) -> None:
    """Writes both files into a folder that exists. Raises `OSError` when that cannot be done."""
    (folder / JSON_NAME).write_bytes(msgspec.json.format(msgspec.json.encode(report), indent=1) + b"\n")
    (folder / PAGE_NAME).write_text(render_page(report), encoding="utf-8")


def render_page(report: CampaignReport) -> str:
    """The report as a page that needs no script and nothing from outside."""
    totals = {outcome: sum(found[outcome] for found in report.summary.values()) for outcome in OUTCOMES}
    ids = len({result.id for result in report.faults})
    return render(
        "pcmrs_lab.campaign", TEMPLATE, values,
        report=report, totals=totals, ids=ids, outcomes=OUTCOMES, marks=MARKS, responses=RESPONSES,
    )  # fmt: skip


def values(details: dict[str, object]) -> str:
    """Measured values in one line."""
    return ", ".join(f"{name.replace('_', ' ')} {_value(value)}" for name, value in details.items())


def _value(value: object) -> str:
    return f"{value:.4g}" if isinstance(value, float) else str(value)
