"""The picture of placements over seeds: every placement is a point at its seed, with the mean of each kind of error."""

from __future__ import annotations

import numpy as np
import pytest

from pcmrs_lab.experiment.placement_plot import placements_figure
from tests.unit.lab.experiment.example_reports import placement_report

pytest.importorskip("matplotlib")


def test_every_placement_is_a_point_at_its_seed() -> None:
    translation, rotation, registration = placements_figure([placement_report(2, 3), placement_report(5, 2)]).axes
    measured, mean = translation.lines[:2]
    assert np.array(measured.get_xdata()).tolist() == [2, 2, 2, 5, 5]
    assert np.array(measured.get_ydata()).tolist() == pytest.approx([2.1, 2.2, 2.3, 5.1, 5.2])
    assert np.array(mean.get_ydata())[0] == pytest.approx(np.mean([2.1, 2.2, 2.3, 5.1, 5.2]))
    assert [line.get_label() for line in translation.lines[::2]] == ["tracker-measured", "true"]
    assert (len(rotation.lines), len(registration.lines)) == (4, 2)


def test_a_single_seed_has_an_axis_of_whole_numbers() -> None:
    (axes, *_) = placements_figure([placement_report(7)]).axes
    assert axes.get_xlim() == (6.5, 7.5)
    assert axes.get_ylim()[0] == 0.0
