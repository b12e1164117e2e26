"""The report says what the journal says, by itself, and the same every time."""

from __future__ import annotations

import math
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.unit.replay.golden import WORKFLOWS
from tests.unit.report.report_journals import Row, golden_rows, write_journal
from tests.unit.report.report_page import name, outcomes, page_of, run, shown

pytestmark = pytest.mark.usefixtures("without_figures")

COURSE, REGISTRATIONS, PLACEMENTS, REFUSALS, EVENTS = 6, 8, 9, 7, 5
"""Columns of the tables."""


def in_tool(quat_xyzw: list[float], vector: Any) -> Any:
    """A vector in the axes of a pose, by quaternion algebra."""
    axis, w = -np.array(quat_xyzw[:3]), quat_xyzw[3]
    return vector + 2.0 * np.cross(axis, np.cross(axis, vector) + w * vector)


def expected_placements(rows: list[Row]) -> list[list[str]]:
    expected = []
    for number, row in outcomes(rows, "accepted"):
        told = row["verdict"]["result"] or {}
        if "planned" not in told:
            continue
        apart = np.array(told["measured"]["position"]) - np.array(told["planned"]["position"])
        axes = 1000.0 * in_tool(told["measured"]["quat_xyzw"], apart)
        error = [1000.0 * told["translation_error"], math.degrees(told["rotation_error"])]
        expected.append([str(number), name(row), *(shown(value, 3) for value in (*axes, *error))])
    return expected


def expected_registrations(rows: list[Row]) -> list[list[str]]:
    limits = rows[0]["result"]["settings"]["procedure"]["registration"]
    expected = []
    for number, row in outcomes(rows, "accepted"):
        kept, told = (row.get("result") or {}).get("registered"), row["verdict"]["result"] or {}
        if not kept:
            continue
        tre = None if told.get("tre") is None else 1000.0 * told["tre"]
        mean, rms = 1000.0 * kept["residual"], 1000.0 * kept["rms"]
        allowed = shown(limits["residual_limit_mm"], 1), shown(limits["tre_limit_mm"], 1)
        expected.append([str(number), name(row), shown(mean, 2), shown(rms, 2), allowed[0], shown(tre, 2), allowed[1]])
    return expected


@pytest.mark.parametrize("workflow", WORKFLOWS)
def test_the_page_says_what_the_journal_says(workflow: str, tmp_path: Path) -> None:
    rows = golden_rows(workflow)
    page = page_of(write_journal(rows, tmp_path / "j.sqlite"))

    placements = expected_placements(rows)
    assert [[cells[1], *cells[3:]] for cells in page.rows(PLACEMENTS)] == placements
    assert f"Placements {len(placements)} error" in page.words
    assert [[cells[0], *cells[2:]] for cells in page.rows(REGISTRATIONS)] == expected_registrations(rows)

    not_accepted = outcomes(rows, "rejected", "failed", "unknown")
    refused = Counter((name(row), row["verdict"]["decision"]) for _, row in not_accepted)
    told: Counter[tuple[str, str]] = Counter()
    for cells in page.rows(REFUSALS):
        told[cells[2].removesuffix("bus:local"), cells[4]] += int(cells[3])
    assert told == refused
    done, counts = outcomes(rows, "accepted"), Counter(decision for _, decision in refused.elements())
    assert f"{len(done) + refused.total()} operations were asked for, {len(done)} were done" in page.words
    assert ("its outcome is unknown" in page.words) == (counts["unknown"] > 0)
    dangers = [
        row for row in rows if row["kind"] == "device" and row["result"]["danger"] and row["source"] != "shutdown"
    ]
    stops = {round(row["wall"]) for row in dangers if row["operation"] == "stopped"}  # asked for twice at once
    faults = [row for row in dangers if row["operation"] != "stopped"]
    summary = f"{counts['rejected']} refused, {counts['failed']} failed, {counts['unknown']} unknown"
    assert f"{len(stops)} · {len(faults)} {summary}" in page.words

    assert page.value("Patient") == "phantom"
    assert page.value("Journal") == f"verified: whole, and signed, {len(rows)} rows"
    assert page.value("Workflow").startswith(f"{workflow} {rows[0]['blueprint']['version']}")
    assert "The daemon ended unexpectedly once and was restarted." in page.words
    assert "Research software, not a medical device. Simulated:" in page.words


def test_a_journal_is_not_written_over(tmp_path: Path) -> None:
    journal = write_journal(golden_rows("ratms")[:5], tmp_path / "j.sqlite")
    before = journal.read_bytes()
    for words in (("-o", journal), ("-o", tmp_path / "page.html", "--pdf", journal)):
        assert run(journal, *words)[0] == 2
    assert journal.read_bytes() == before
