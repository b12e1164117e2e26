"""Figures of placements, pose logs and responses: they show the numbers that they are made from."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from pcmrs.analysis.placements import PlacementTrial
from pcmrs.analysis.plots import draw_mep, mep_figure, placement_figure, pose_log_figure
from pcmrs.formats.pose_file import Placement
from pcmrs.formats.pose_log import PoseLog
from pcmrs.messages import Epoch
from pcmrs.spatial import Transform
from pcmrs.tms.mep import judge_mep
from pcmrs.tms.settings import MepSettings

RATE_HZ = 4000.0


def epoch(pulse: int, microvolts: float, rest_uv: float = 2.0) -> Epoch:
    times = -0.12 + np.arange(900) / RATE_HZ
    shape = np.where((times > 0.022) & (times < 0.032), np.sin((times - 0.022) * 2.0 * np.pi / 0.010), 0.0)
    noise = np.random.default_rng(pulse).normal(0.0, rest_uv * 1e-6, len(times))
    samples = 0.5e-6 * microvolts * shape + noise
    return Epoch(pulse=pulse, muscle="FDI", rate_hz=RATE_HZ, start=-0.12, samples=samples.tolist())


def test_responses_are_drawn_with_what_was_found(tmp_path: Path) -> None:
    settings = MepSettings()
    epochs = [epoch(1, 300.0), epoch(2, 20.0), epoch(3, 300.0, rest_uv=15.0)]
    meps = [judge_mep(each, settings) for each in epochs]
    titles = [axes.get_title(loc="left") for axes in mep_figure(epochs, meps, settings).axes]
    assert [title.split(": ")[-1] for title in titles] == ["response", "no response", "preactivated"]
    assert "FDI, pulse 1" in titles[0]
    draw_mep(tmp_path / "mep.png", epochs, meps, settings)
    assert (tmp_path / "mep.png").read_bytes().startswith(b"\x89PNG")


def trial(number: int, off_mm: float, turned_deg: float) -> PlacementTrial:
    """A placement 10 mm before its target, off by so much along x."""
    planned = Transform.from_rotvec((0.01 * number, 0.0, 0.1), (0.0, 0.4, 0.0))
    error = Transform.from_rotvec((off_mm / 1000.0, 0.0, 0.010), (0.0, 0.0, np.radians(turned_deg)))
    return PlacementTrial(Placement(str(number), planned, planned @ error), 0.010)


def test_placements_are_drawn_in_millimetres_and_degrees() -> None:
    trials = [trial(1, 0.5, 1.0), trial(2, 1.5, 3.0)]
    errors, turned, vectors = placement_figure(trials, "two placements").axes
    assert [bar.get_height() for bar in errors.patches] == pytest.approx([0.5, 1.5])
    assert list(errors.lines[0].get_ydata()) == pytest.approx([1.0, 1.0])
    assert list(turned.lines[0].get_ydata()) == pytest.approx([1.0, 3.0])
    assert "mm" in errors.get_ylabel()
    assert "°" in turned.get_ylabel()
    # The longest arrow is a quarter of the extent of the targets, which is 10 mm at least.
    assert "error, 1.67 times its length" in vectors.get_legend_handles_labels()[1]


@pytest.mark.parametrize("off_mm", [0.0, 0.3])
def test_a_single_placement_is_drawn(off_mm: float) -> None:
    errors, *_ = placement_figure([trial(1, off_mm, 0.0)], "one placement").axes
    assert [bar.get_height() for bar in errors.patches] == pytest.approx([off_mm], abs=1e-9)


def test_gaps_of_a_pose_log_stay_gaps() -> None:
    place = Transform.from_rotvec((0.1, 0.2, -1.0), (0.1, 0.0, 0.0))
    moved = Transform(place.rotation, place.translation + np.array((0.0, 0.002, 0.0)))
    series: dict[str, list[Transform | None]] = {
        "body_tool": [place, None, moved],
        "pol_body": [place, Transform.identity(), place],
        "pol_tool": [None, None, None],
    }
    first, second, third = pose_log_figure(PoseLog("poses_1", series)).axes
    np.testing.assert_allclose(first.lines[1].get_ydata(), [-1.0, np.nan, 1.0], atol=1e-9)
    assert np.isnan(second.lines[0].get_ydata()[1]), "the identity stands for a body that was not tracked"
    assert not third.lines
