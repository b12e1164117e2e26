"""The contents of a report are those of the journal."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.unit.report.report_journals import Row, altered, golden_rows, write_journal
from tests.unit.report.report_page import name, outcomes, page_of, run, shown

COURSE, REGISTRATIONS, PLACEMENTS, REFUSALS, EVENTS = 6, 8, 9, 7, 5
"""Columns of the tables."""


@pytest.mark.usefixtures("without_figures")
def test_landmarks_have_their_distances_and_gates_their_values(tmp_path: Path) -> None:
    rows = golden_rows("ratms")
    page = page_of(write_journal(rows[:40], tmp_path / "j.sqlite"))
    ((_, row),) = [each for each in outcomes(rows[:40], "accepted") if name(each[1]) == "registration.register"]
    names = [landmark["name"] for landmark in row["result"]["registered"]["landmarks"]]
    distances = row["verdict"]["result"]["distances"]
    assert {landmark: page.value(landmark) for landmark in names} == {
        landmark: shown(1000.0 * distance, 2) for landmark, distance in zip(names, distances, strict=True)
    }
    gates = {gate["name"]: gate for gate in row["verdict"]["result"]["gates"]}
    (cells,) = [cells for cells in page.cells if cells[0] == "landmark outlier"]
    assert cells[1] == "passed"
    assert float(cells[2]) == pytest.approx(gates["landmark_outlier"]["value"], rel=1e-3)


@pytest.mark.usefixtures("without_figures")
def test_the_numbers_are_there_for_programs(tmp_path: Path) -> None:
    rows = golden_rows("grid_mapping")
    status, out, _ = run(write_journal(rows, tmp_path / "j.sqlite"), "-o", tmp_path / "page.html", "--json")
    found = json.loads(out)
    assert status == 0
    measured = [row["verdict"]["result"] for _, row in outcomes(rows, "accepted") if name(row) == "placement.confirm"]
    (placement,) = [each for each in found["placements"] if each["operation"] == "placement.confirm"]
    assert placement["error_mm"] == pytest.approx(1000.0 * measured[0]["translation_error"])
    assert placement["error_mm"] == pytest.approx(float(np.linalg.norm(placement["axes_mm"])))
    assert [run["in_order"] for run in found["runs"]] == [False, True]


@pytest.mark.usefixtures("without_figures")
def test_one_session_is_reported_without_any_other_patient(tmp_path: Path) -> None:
    def other_patient(row: Row) -> None:
        if row["kind"] == "config" and row["session_id"] == second:
            row["result"]["settings"]["procedure"]["patient"] = "another"

    rows = golden_rows("ratms")
    first, second = dict.fromkeys(row["session_id"] for row in rows)
    journal = write_journal(altered(rows, other_patient), tmp_path / "j.sqlite")
    page = page_of(journal)
    assert page.value("Patient") == "another"
    assert page.value("Others in the journal") == "1 earlier, 0 later"
    assert first not in page.words
    assert page.rows(PLACEMENTS) == []
    page = page_of(journal, "--session", first[:6])
    assert page.value("Patient") == "phantom"
    assert "The journal has no orderly end of this session." in page.words
    assert second not in page.words
    status, _, err = run(journal, "-o", tmp_path / "none.html", "--session", "nobody")
    assert (status, (tmp_path / "none.html").exists()) == (5, False)
    assert second in err


@pytest.mark.usefixtures("without_figures")
def test_a_device_that_is_not_simulated_is_named(tmp_path: Path) -> None:
    def real(row: Row) -> None:
        if row["kind"] == "config":
            row["result"]["settings"]["robot"]["driver"] = "kst"

    page = page_of(write_journal(altered(golden_rows("ratms")[:5], real), tmp_path / "j.sqlite"))
    assert "Devices by driver: robot kst, tracker simulated" in page.words
    assert "nobody was treated" not in page.words


def test_a_journal_that_says_little_is_reported(tmp_path: Path) -> None:
    page = page_of(write_journal(golden_rows("ratms")[1:3], tmp_path / "j.sqlite"))
    assert "The journal does not say whether devices were simulated." in page.words
    assert page.value("Patient") == "not named"
    assert "nothing was registered" in page.words


@pytest.mark.parametrize("settings", [5, {"procedure": [1]}, {"cell": "x"}, {"cell": {"rate": "fast"}}])
def test_values_that_no_program_of_ours_writes_are_refused(settings: Any, tmp_path: Path) -> None:
    """Found by `fuzz.journals`: a report ended with an `AttributeError`."""

    def change(row: Row) -> None:
        if row["kind"] == "config":
            row["result"]["settings"] = settings

    journal = write_journal(altered(golden_rows("ratms"), change), tmp_path / "j.sqlite")
    status, _, said = run(journal, "-o", tmp_path / "page.html")
    assert status != 0
    assert "cannot be reported" in said
