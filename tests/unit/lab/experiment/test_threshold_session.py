"""A session on a simulated cell: its record is that of the journal, and it keeps what was done when it ends early."""

from __future__ import annotations

import asyncio
import hashlib
import sqlite3
from collections.abc import AsyncIterator, Sequence
from contextlib import asynccontextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import msgspec
import pytest

from pcmrs.analysis.session import SessionRecord
from pcmrs.errors import CommandRefusedError, UnknownOutcomeError
from pcmrs.messages import PoseMessage, SceneTruth
from pcmrs.report.session_folder import JOURNAL, SUMS
from pcmrs.testing.plan import example_plan, read_plan
from pcmrs_lab.experiment import threshold_session
from pcmrs_lab.experiment.session.runner import SessionRunner
from pcmrs_lab.experiment.session.setup import SessionSetup
from pcmrs_lab.experiment.threshold_session import (
    INTERRUPTED,
    read_record,
    report_of,
    run_threshold_session,
    true_of,
)
from tests.support.session_records import nothing, record
from tests.unit.report.report_journals import golden_rows, write_journal

HERE = PoseMessage(position=(0.0, 0.0, 0.0), quat_wxyz=(1.0, 0.0, 0.0, 0.0))
QUICK = (
    "procedure.max_pose_age=0.6",  # a test machine that does much else may leave a process alone for so long
    "procedure.motion.joint_speed_fraction=1.0",
    "procedure.motion.joint_acceleration=5.0",
    "procedure.motion.linear_velocity=0.5",
    "procedure.placement.frames=5",
    "procedure.placement.tolerance_mm=0.5",  # of so few frames the mean is no better
    "procedure.placement.tolerance_deg=0.2",
    "procedure.registration.samples=5",
    "procedure.stimulation.intervals.least=1.1",
    "procedure.stimulation.threshold.interval=0.3",
    "sim.digitization.reach_time=0.1",
    "sim.digitization.rest_time=0.1",
)


def setup(**given: Any) -> SessionSetup:
    return SessionSetup(read_plan(example_plan("ratms")), **given)


def test_true_threshold_is_higher_beside_the_hotspot() -> None:
    scene = SceneTruth(
        tracker_from_coil=HERE,
        tracker_from_body_ref=HERE,
        body_ref_from_image=HERE,
        image_from_hotspot=HERE,
        threshold=50.0,
    )
    beside = PoseMessage(position=(0.005, 0.0, 0.0), quat_wxyz=(1.0, 0.0, 0.0, 0.0))
    at, off = true_of(scene, HERE), true_of(scene, beside)
    assert at is not None
    assert off is not None
    assert at.threshold_here == pytest.approx(50.0)
    assert off.threshold_here is not None
    assert off.threshold_here > 51.0
    assert true_of(msgspec.structs.replace(scene, threshold=None), HERE) is None


def test_summary_counts_pulses_by_phase_in_units_of_people(tmp_path: Path) -> None:
    full = record()
    found = report_of(full, tmp_path)
    counted = sum(pulse.phase in ("hotspot", "threshold") for pulse in full.pulses)
    assert found.hotspot_pulses + found.threshold_pulses == counted < found.pulses == len(full.pulses)
    assert full.hotspot is not None
    assert found.hotspot_mm == pytest.approx([1e3 * each for each in full.hotspot.image_from_coil.position])
    assert found.hotspot_uncertainty_mm == pytest.approx(1e3 * full.hotspot.uncertainty)
    assert found.placements == 2
    assert found.placement_error_mm == pytest.approx((0.031 + 0.053) / 2)
    assert (found.ended, found.residual_mm, found.folder) == ("", 1.84, str(tmp_path))


def test_summary_of_an_empty_session_has_no_results(tmp_path: Path) -> None:
    found = report_of(nothing(), tmp_path)
    missing = (
        "residual_mm",
        "placement_error_mm",
        "hotspot_mm",
        "hotspot_uncertainty_mm",
        "threshold",
        "threshold_low",
    )
    assert [getattr(found, name) for name in missing] == [None] * len(missing)
    assert (found.pulses, found.placements, found.ended) == (0, 0, "it was interrupted.")


@pytest.fixture
def journal(tmp_path: Path) -> Path:
    return write_journal(golden_rows("ratms_threshold")[:40], tmp_path / "cell" / "live.sqlite")


def test_record_is_that_of_the_journal_and_the_setup(journal: Path) -> None:
    found = read_record(journal, setup(seed=4, rate=2.0), None, "it was too late.")
    assert (found.seed, found.rate, found.ended, found.truth) == (4, 2.0, "it was too late.", None)
    assert found.registration is not None
    assert "sim.seed=4" in found.settings
    assert {"Python", "pcmrs", "mujoco"} <= found.versions.keys()


@pytest.mark.parametrize("answers", [True, False])
async def test_a_refused_session_stops_the_cell_and_says_why(
    tmp_path: Path, journal: Path, monkeypatch: pytest.MonkeyPatch, answers: bool
) -> None:
    """The daemon may have ended before: the session is written all the same."""
    stopped: list[bool] = []

    async def truth() -> SceneTruth:
        return SceneTruth(tracker_from_coil=HERE, tracker_from_body_ref=HERE, body_ref_from_image=HERE)

    async def stop() -> None:
        stopped.append(answers)
        if not answers:
            raise UnknownOutcomeError("The daemon has ended.")

    @asynccontextmanager
    async def bench(_: Sequence[str]) -> AsyncIterator[SimpleNamespace]:
        client, scene = SimpleNamespace(stop=stop), SimpleNamespace(truth=truth)
        yield SimpleNamespace(client=client, scene=scene, journal=SimpleNamespace(path=journal))

    async def refuse(_: object) -> None:
        raise CommandRefusedError("No hot-spot was found.")

    monkeypatch.setattr(threshold_session, "private_bench", bench)
    monkeypatch.setattr(SessionRunner, "run", refuse)
    monkeypatch.setattr(SessionRunner, "__init__", lambda *_: None)
    monkeypatch.setattr(threshold_session, "write_results", lambda *_: None)
    steps: list[str] = []
    report = await run_threshold_session(setup(), tmp_path / "out", lambda doing, _done, _total: steps.append(doing))
    assert (report.ended, stopped) == ("No hot-spot was found.", [answers])
    assert steps == ["starting the daemon", "writing the report", "done"]
    check_sums(tmp_path / "out")


def check_sums(folder: Path) -> None:
    lines = [line.split("  ", 1) for line in (folder / SUMS).read_text().splitlines()]
    listed = {name: digest for digest, name in lines}
    files = {path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file()}
    assert set(listed) == files - {SUMS}
    assert all(hashlib.sha256((folder / name).read_bytes()).hexdigest() == digest for name, digest in listed.items())


@pytest.mark.timeout(300)  # of a machine that does much else
@pytest.mark.nightly
async def test_a_session_from_landmarks_to_threshold(tmp_path: Path) -> None:
    asked, told = setup(seed=4, budget=3, overrides=QUICK), []
    report = await run_threshold_session(asked, tmp_path, lambda doing, _done, _total: told.append(doing))
    assert report.ended == ""
    assert report.threshold is not None
    assert report.hotspot_pulses >= 3
    assert report.threshold_error is not None
    assert abs(report.threshold_error) < 40.0  # of a hunt that ends early
    record = read_record(tmp_path / JOURNAL, asked, None, "")
    assert isinstance(record, SessionRecord)
    assert [pulse.pulse for pulse in record.pulses] == list(range(1, report.pulses + 1))
    assert all(pulse.error_mm <= 1.5 and pulse.intensity <= 90.0 for pulse in record.pulses)
    page = (tmp_path / "report.html").read_text()
    assert "Simulated." in page
    assert "Incomplete" not in page
    assert f"{report.threshold:g}" in page
    check_sums(tmp_path)
    with sqlite3.connect(tmp_path / JOURNAL) as journal:
        assert journal.execute("PRAGMA integrity_check").fetchone() == ("ok",)
    assert told[-1] == "done"
    assert any(doing.startswith("hunting") for doing in told)


@pytest.mark.slow
@pytest.mark.nightly
async def test_an_interrupted_session_keeps_what_was_recorded(tmp_path: Path) -> None:
    asked = setup(seed=4, budget=3, overrides=QUICK)
    task = asyncio.current_task()
    assert task is not None

    def interrupt(doing: str, _done: int, _total: int) -> None:
        if doing.endswith("pulse 2"):
            task.cancel()

    report = await run_threshold_session(asked, tmp_path, interrupt)
    assert report.ended == INTERRUPTED
    assert report.pulses >= 1
    assert report.threshold is None
    assert "Incomplete." in (tmp_path / "report.html").read_text()
    check_sums(tmp_path)


@pytest.mark.nightly
async def test_a_muscle_that_is_never_at_rest_ends_the_session(tmp_path: Path) -> None:
    asked = setup(seed=4, budget=3, overrides=(*QUICK, "sim.muscle.preactivation_uv=40"))
    report = await run_threshold_session(asked, tmp_path, lambda *_: None)
    assert report.ended.startswith("8 pulses in a row do not count. The last one: ")
    assert (report.pulses, report.hotspot_pulses, report.threshold) == (8, 0, None)
    record = read_record(tmp_path / JOURNAL, asked, None, report.ended)
    assert {pulse.problem for pulse in record.pulses} <= {"preactivated", "artefact"}
    assert all(pulse.problem_text for pulse in record.pulses)
