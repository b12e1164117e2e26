"""`pcmrs experiment registrations`: true against predicted errors of refinements, without a daemon."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from pcmrs.cli import main
from pcmrs_lab.cli.registration_tables import registration_table
from pcmrs_lab.experiment import registrations
from pcmrs_lab.experiment.registration_plot import registrations_figure
from pcmrs_lab.experiment.registrations import (
    ROWS,
    USUAL,
    RegistrationRow,
    RegistrationsReport,
    run_registrations,
    touched_skin,
)
from pcmrs_sim import head
from tests.unit.lab.cli.shown import shown


def run(runs: int, seed: int = 1) -> RegistrationsReport:
    return run_registrations(runs, seed, lambda _text, _done, _total: None)


@pytest.fixture(scope="module")
def report() -> RegistrationsReport:
    return run(6)


def of(report: RegistrationsReport, name: str, value: str) -> RegistrationRow:
    (found,) = [row for row in report.rows if (row.property, row.value) == (name, value)]
    return found


def test_hair_is_found_and_the_target_with_it(report: RegistrationsReport) -> None:
    for hair in (0.0, 2.0, 4.0, 6.0):
        row = of(report, "hair", f"{hair:g} mm")
        assert row.refined.refused == {}
        assert row.refined.true_mm is not None
        assert row.refined.true_mm < 1.2
        assert row.hair_mm == pytest.approx(hair, abs=0.4)
        assert row.landmarks.true_mm is not None
        assert row.refined.true_mm < row.landmarks.true_mm


def test_hair_beyond_the_range_is_refused(report: RegistrationsReport) -> None:
    row = of(report, "hair", "10 mm")
    assert row.refined.refused == {"surface_offset_too_large": 6}
    assert (row.refined.true_mm, row.refined.predicted_mm, row.hair_mm) == (None, None, None)


def test_plain_icp_is_worse_through_hair(report: RegistrationsReport) -> None:
    row = of(report, "hair", "4 mm")
    assert row.icp.true_mm is not None
    assert row.refined.true_mm is not None
    assert row.icp.true_mm > row.refined.true_mm
    assert row.icp.predicted_mm is None


def test_every_row_is_in_table_and_picture(report: RegistrationsReport) -> None:
    text = " ".join(shown(registration_table(report)).split())
    assert "Plain ICP: trimesh" in text
    assert all(name in text and value in text for name, value, _ in ROWS)
    figure = registrations_figure(report)
    assert [axes.get_xlabel() for axes in figure.axes] == list(dict.fromkeys(name for name, _, _ in ROWS))


def test_equal_seeds_give_equal_reports(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(registrations, "ROWS", ROWS[:1])
    assert run(2) == run(2)
    assert run(2) != run(2, seed=2)


@pytest.mark.parametrize("region", registrations.REGIONS)
def test_touches_are_where_and_as_far_off_as_they_should(region: registrations.Region) -> None:
    touches = replace(USUAL, region=region, noise_mm=0.0, hair_mm=3.0, outliers=10)
    points = touched_skin(touches, np.random.default_rng(1))
    off = np.array([np.linalg.norm(point - head.surface_point(point - head.CENTRE)) for point in points])
    assert points.shape == (100, 3)
    assert (off[10:] < 0.0036).all()  # measured along a ray, which is not the normal
    assert off[:10].max() > 0.005
    if region == "face":
        assert (off[10:] < 1e-6).any()


def test_the_command_prints_and_draws(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(registrations, "ROWS", ROWS[:2])
    picture = tmp_path / "registrations.png"
    done = CliRunner().invoke(main, ["experiment", "registrations", "--runs", "2", "--plot", str(picture), "--json"])
    assert done.exit_code == 0, done.output
    assert json.loads(done.stdout)["runs"] == 2
    assert picture.read_bytes().startswith(b"\x89PNG")
