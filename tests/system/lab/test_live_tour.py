"""`pcmrs fsm test --live`: a daemon does over the bus what its workflow says, as far as the time reaches."""

from __future__ import annotations

from pathlib import Path

import msgspec
import pytest

from pcmrs.authoring.trial.tour import TourCommand
from pcmrs_lab.experiment.tours.report import TourReport
from tests.system.daemon.daemon_process import own_settings, run_pcmrs, running_daemon

pytestmark = pytest.mark.slow

SECONDS = "10"


def check(report: TourReport) -> None:
    """What was seen is as it must be; the time does not reach for all of it."""
    assert report.deviations == {"cell": []}
    assert not report.passed
    assert any(left.reason == "the time was up" for left in report.left)
    assert report.coverage["rejected"].covered > 30
    assert report.coverage["accepted"].covered > 10
    assert report.coverage["steps"].covered > 0
    assert report.stops > 0


@pytest.mark.nightly
def test_tour_starts_its_own_daemon(tmp_path: Path) -> None:
    file = tmp_path / "tour.jsonl"
    run = run_pcmrs("fsm", "test", "ratms", "--live", "--json", "--time-limit", SECONDS, "-o", str(file))
    assert run.returncode == 1, run.stderr
    report = msgspec.json.decode(run.stdout, type=TourReport)
    check(report)
    moves = [msgspec.json.decode(line, type=TourCommand) for line in file.read_bytes().splitlines()]
    assert len(moves) == report.subjects["cell"]


@pytest.mark.nightly
def test_a_running_daemon_is_toured_and_serves_on(tmp_path: Path) -> None:
    with running_daemon(own_settings(tmp_path), tmp_path) as daemon:
        address = ("--endpoint", daemon.ready.endpoint, "--site", "test", "--cell", daemon.cell)
        words = ("fsm", "test", "ratms", "--live", "--connect", *address)
        run = run_pcmrs(*words, "--json", "--time-limit", SECONDS)
        assert run.returncode == 1, run.stderr
        check(msgspec.json.decode(run.stdout, type=TourReport))
        other = run_pcmrs("fsm", "test", "femoroplasty", *words[3:])
        assert other.returncode == 2
        assert "The cell runs ratms" in other.stderr
        assert daemon.pcmrs("state").returncode == 0
        assert "Traceback" not in daemon.log
