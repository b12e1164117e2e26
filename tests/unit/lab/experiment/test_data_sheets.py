"""Settings of simulated devices with the values of data sheets."""

from __future__ import annotations

import math
from typing import Any

import pytest

from pcmrs.config import set_values
from pcmrs.settings import read_settings
from pcmrs_lab.experiment.data_sheets import NAMES, SHEETS, TrackerName, data_sheet_settings
from tests.unit.workflows.workflow_bench import open_bench


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


@pytest.mark.parametrize("name", NAMES)
async def test_placements_converge_with_such_devices(name: TrackerName) -> None:
    """With the tolerance for a quiet tracker and an exact arm, they fail."""
    values: dict[str, Any] = {}
    set_values(values, data_sheet_settings(name, virtual=False))
    limits = {"frames": 60, "settle_time": 0.3, "tolerance_mm": 0.08, "tolerance_deg": 0.03}
    limits |= values["procedure"]["placement"]
    async with open_bench({"placement": limits, "registration": {"samples": 20}}, sim=values["sim"]) as bench:
        placed = await bench.to_placed()
    assert placed.result is not None
    tolerance, last = placed.result["tolerance"], placed.result["corrections"][-1]
    assert 0.08 <= tolerance["mm"] <= 0.5
    assert last["shift_mm"] <= tolerance["mm"]
    assert placed.result["translation_error"] < 0.0005
