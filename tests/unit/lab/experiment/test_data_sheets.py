"""Settings of simulated devices with the values of data sheets."""

from __future__ import annotations

import math

import pytest

from pcmrs.settings import read_settings
from pcmrs_lab.experiment.data_sheets import NAMES, SHEETS, TrackerName, data_sheet_settings


@pytest.mark.parametrize("name", NAMES)
def test_a_body_scatters_and_errs_as_its_sheet_says(name: TrackerName) -> None:
    settings = data_sheet_settings(name, virtual=True)
    cell = read_settings(None, [*settings, "robot.driver=kst", "tracker.driver=ndi"])
    tracker = cell.sim["tracker"]
    total = math.hypot(tracker["jitter_mm"] * math.sqrt(3.0), tracker["bias_mm"])
    assert total == pytest.approx(SHEETS[name].accuracy_mm, rel=1e-3)
    assert tracker["rate_hz"] == SHEETS[name].rate_hz
    assert cell.ndi["latency"] == tracker["latency"]
    assert cell.sim["arm"]["repeatability_mm"] == 0.15


def test_without_its_driver_a_tracker_has_no_latency_to_configure() -> None:
    assert not any(each.startswith("ndi.") for each in data_sheet_settings("vicra", virtual=False))
