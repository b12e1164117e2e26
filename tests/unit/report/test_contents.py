"""Contents of a report: what counts as simulated, and as a problem."""

from __future__ import annotations

from pathlib import Path

import msgspec
import pytest

from pcmrs.report._contents import ReportedFile, SessionReport
from pcmrs.report.reading import read_report
from tests.unit.report.report_journals import golden_rows, write_journal


@pytest.fixture(scope="module")
def report(tmp_path_factory: pytest.TempPathFactory) -> SessionReport:
    return read_report(write_journal(golden_rows("ratms"), tmp_path_factory.mktemp("cell") / "j.sqlite"))


@pytest.mark.parametrize(
    ("devices", "simulated"),
    [
        ({"robot": "sim", "tracker": "sim"}, True),
        ({"robot": "kst", "tracker": "sim"}, False),
        ({}, False),
    ],
)
def test_one_real_device_makes_a_session_real(report: SessionReport, devices: dict[str, str], simulated: bool) -> None:
    assert msgspec.structs.replace(report, devices=devices).simulated == simulated


def test_problems_are_those_of_the_journal_and_of_wrong_files(report: SessionReport) -> None:
    assert report.problems == ()
    journal = msgspec.structs.replace(report.journal, problems=("Row 5 is lost.",))
    files = (
        ReportedFile(name="a.mcap", size=1, sha256="", note="was not ended: its last second may be missing"),
        ReportedFile(name="b.toml", size=0, sha256="", note="is not there", wrong=True),
    )
    damaged = msgspec.structs.replace(report, journal=journal, files=files)
    assert damaged.problems == ("Row 5 is lost.", "b.toml is not there.")


def test_events_are_divided_by_their_kind(report: SessionReport) -> None:
    by_kind = [report.events_of(kind) for kind in ("stop", "fault", "notice")]
    assert sorted(event.sequence for events in by_kind for event in events) == [each.sequence for each in report.events]
    assert report.events_of("stop"), "the golden session has a Stop"


def test_a_report_is_plain_data(report: SessionReport, tmp_path: Path) -> None:
    file = tmp_path / "report.json"
    file.write_bytes(msgspec.json.encode(report))
    assert msgspec.json.decode(file.read_bytes(), type=SessionReport) == report
