"""The report says what the journal says, by itself, and the same every time."""

from __future__ import annotations

import json
import math
import re
import shutil
import sqlite3
from collections import Counter
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner

from pcmrs.cli import main
from tests.unit.report.report_journals import Row, altered, golden_rows, write_journal
from tests.unit.report.report_page import Page

WORKFLOWS = ("ratms", "femoroplasty", "grid_mapping", "ratms_threshold")
COURSE, REGISTRATIONS, PLACEMENTS, REFUSALS, EVENTS = 6, 8, 9, 7, 5
"""Columns of the tables."""
NASTY = "<script>alert('$x_{')</script> & \"Zoë\" 患者 http://example.org"


def run(*words: object) -> tuple[int, str, str]:
    result = CliRunner().invoke(main, ["report", *map(str, words)])
    assert result.exception is None or isinstance(result.exception, SystemExit), result.exception
    return result.exit_code, result.stdout, result.stderr


def page_of(source: Path, *words: object, status: int = 0) -> Page:
    output = source.parent / "page.html"
    assert run(source, "-o", output, *words)[0] == status
    return Page(output.read_text())


def outcomes(rows: list[Row], *decisions: str) -> list[tuple[int, Row]]:
    """Sequence and row of what ended so."""
    found = [(number, row) for number, row in enumerate(rows, 1) if row["kind"] == "outcome"]
    return [(number, row) for number, row in found if row["verdict"]["decision"] in decisions]


def name(row: Row) -> str:
    return f"{row['branch']}.{row['operation']}"


def shown(value: float | None, digits: int) -> str:
    return "–" if value is None else f"{value:.{digits}f}".replace("-", "−")


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
    assert ("nobody knows how it ended" in page.words) == (counts["unknown"] > 0)
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


def test_page_and_pdf_are_reproducible_wherever_the_journal_lies(tmp_path: Path) -> None:
    journal = write_journal(golden_rows("ratms_threshold"), tmp_path / "cell" / "ratms_threshold.sqlite")
    shutil.copytree(journal.parent, tmp_path / "copy")
    written = []
    for source in (journal, tmp_path / "copy"):
        assert run(source, "-o", tmp_path / "a.html", "--pdf", tmp_path / "a.pdf")[0] == 0
        written.append([(tmp_path / name).read_bytes() for name in ("a.html", "a.pdf")])
    assert written[0] == written[1]
    html, pdf = written[0]
    assert pdf.startswith(b"%PDF-")
    assert pdf.rstrip().endswith(b"%%EOF")
    assert str(tmp_path).encode() not in html + pdf


def test_page_runs_and_loads_nothing_and_journal_text_is_text(tmp_path: Path) -> None:
    def poison(row: Row) -> None:
        result = row.get("result") or {}
        if row["kind"] == "config":
            result["settings"]["procedure"] |= {"patient": NASTY, "operator": NASTY}
        if row.get("user"):
            row["user"] = NASTY
        for kept in (result.get("registered"), result):
            for landmark in (kept or {}).get("landmarks", []):
                landmark["name"] = f"{landmark['name']} {NASTY}"
        if row.get("verdict") and row["verdict"]["reason"]:
            row["verdict"]["reason"]["text"] = NASTY
        if row["kind"] == "device":
            result["text"] = row["operation"] = NASTY

    journal = write_journal(altered(golden_rows("ratms"), poison), tmp_path / "j.sqlite")
    page = page_of(journal, "--pdf", tmp_path / "page.pdf")
    assert not page.names & {"script", "link", "iframe", "object", "form", "base", "svg"}
    for attribute, value in page.attributes:
        assert not attribute.startswith("on")
        if attribute in ("src", "href"):
            assert value.startswith("data:image/svg+xml;base64,")
    source = (tmp_path / "page.html").read_text()
    assert not re.search(r"url\(|@import", source)
    assert page.value("Patient") == page.value("Operator") == NASTY
    assert page.words.count(NASTY) > 20
    assert (tmp_path / "page.pdf").stat().st_size > 20_000


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
    assert (status, (tmp_path / "none.html").exists()) == (2, False)
    assert second in err


def test_first_page_shows_unfinished_commands_and_open_stops(tmp_path: Path) -> None:
    rows = golden_rows("ratms")
    begun = next(number for number, row in enumerate(rows) if (row["kind"], row["operation"]) == ("intent", "confirm"))
    page = page_of(write_journal(rows[: begun + 1], tmp_path / "begun" / "j.sqlite"))
    assert "confirm (placement): It was in progress when the session ended unexpectedly." in page.words
    stopped = next(number for number, row in enumerate(rows) if row["operation"] == "stopped")
    page = page_of(write_journal(rows[: stopped + 1], tmp_path / "stopped" / "j.sqlite"))
    if "is not installed here" not in page.value("Workflow"):  # only the very workflow says what acknowledges
        assert "At the end a Stop or fault had not been acknowledged." in page.words


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


# -- damage --------------------------------------------------------------------------------------------


def cut(journal: Path) -> None:
    with closing(sqlite3.connect(journal)) as database:
        (guard,) = database.execute("SELECT sql FROM sqlite_schema WHERE name = 'no_delete'").fetchone()
        database.execute("DROP TRIGGER no_delete")
        database.execute("DELETE FROM journal WHERE sequence > 125")
        database.execute(guard)
        database.commit()


def turn_bit(journal: Path, sequence: int) -> None:
    """Of the row's hash, where it lies in the file beside that of the row before it."""
    with closing(sqlite3.connect(journal)) as database:
        query = "SELECT previous_hash, hash FROM journal WHERE sequence = ?"
        hashes = b"".join(database.execute(query, (sequence,)).fetchone())
    whole = bytearray(journal.read_bytes())
    assert whole.count(hashes) == 1
    whole[whole.find(hashes) + 40] ^= 1
    journal.write_bytes(whole)


def forget_key(journal: Path) -> None:
    (journal.parent / "journal.pub").unlink()


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


@pytest.mark.parametrize(
    ("damage", "rows", "said"),
    [
        (cut, 125, "6 acknowledged rows are lost"),
        (lambda journal: turn_bit(journal, 60), 59, "row 60"),
        (forget_key, 131, "journal.pub is not the public key"),
    ],
    ids=["rows cut off", "a bit", "no key"],
)
def test_damaged_journal_is_reported_as_far_as_it_is_good(damage: Any, rows: int, said: str, tmp_path: Path) -> None:
    """The page says first that it is not complete."""
    journal = write_journal(golden_rows("ratms"), tmp_path / "j.sqlite")
    damage(journal)
    before = journal.read_bytes()
    page = page_of(journal, status=1)
    assert page.words.index("The journal is damaged: this report is not complete.") < page.words.index("Placements")
    assert said in page.words
    assert f"the {rows} rows from the first on" in page.words
    assert page.value("Journal").startswith("damaged or not proven")
    assert str(tmp_path) not in page.words
    assert journal.read_bytes() == before


def test_unreadable_source_is_an_error_and_nothing_is_written(tmp_path: Path) -> None:
    journal = write_journal(golden_rows("ratms")[:20], tmp_path / "cell" / "j.sqlite")
    turn_bit(journal, 1)
    text, empty, two = tmp_path / "text", tmp_path / "empty", tmp_path / "two"
    text.write_text("no journal")
    empty.mkdir()
    for number in range(2):
        write_journal(golden_rows("ratms")[:2], two / f"{number}.sqlite")
    for source, said in ((journal, "row 1"), (text, "text"), (empty, "no journal"), (two, "name one")):
        status, out, err = run(source, "-o", tmp_path / "page.html")
        assert (status, out, len(err.splitlines())) == (2, "", 1), err
        assert said in err
    assert not (tmp_path / "page.html").exists()


def test_a_journal_is_not_written_over(tmp_path: Path) -> None:
    journal = write_journal(golden_rows("ratms")[:5], tmp_path / "j.sqlite")
    before = journal.read_bytes()
    for words in (("-o", journal), ("-o", tmp_path / "page.html", "--pdf", journal)):
        assert run(journal, *words)[0] == 2
    assert journal.read_bytes() == before
