"""Settings of simulated devices with the values of data sheets."""

from __future__ import annotations

import math
from typing import Any

import msgspec
import numpy as np
import pytest

from pcmrs.config import set_values
from pcmrs.settings import read_settings
from pcmrs.spatial import Transform
from pcmrs_lab.experiment.data_sheets import NAMES, SHEETS, TrackerName, data_sheet_settings
from pcmrs_sim.error_models import TrackerErrors
from pcmrs_sim.markers import MARKER_BODIES
from pcmrs_sim.settings import TrackerSettings
from tests.unit.workflows.workflow_bench import open_bench


@pytest.mark.parametrize("name", NAMES)
def test_a_body_scatters_and_errs_as_its_sheet_says(name: TrackerName) -> None:
    settings = data_sheet_settings(name, virtual=True)
    cell = read_settings(None, [*settings, "robot.driver=kst", "tracker.driver=ndi"])
    tracker = cell.sim["tracker"]
    assert math.hypot(_scatter_mm(tracker), tracker["bias_mm"]) == pytest.approx(SHEETS[name].accuracy_mm, rel=0.02)
    assert tracker["rate_hz"] == SHEETS[name].rate_hz
    assert cell.ndi["latency"] == tracker["latency"]
    assert cell.sim["arm"]["repeatability_mm"] == 0.15


def _scatter_mm(tracker: dict[str, float]) -> float:
    """3D rms of the measured positions of a body at rest, 1.2 m straight ahead."""
    errors = TrackerErrors(msgspec.convert(tracker | {"bias_mm": 0.0}, TrackerSettings), np.random.default_rng(5))
    spheres = MARKER_BODIES["body_ref"].positions
    pose = Transform(np.eye(3), np.array((0.0, 0.0, -1.2)))
    seen = np.ones(len(spheres), dtype=bool)
    shifts = [errors.measure(pose, spheres, seen)[0].translation - pose.translation for _ in range(2000)]
    return 1e3 * float(np.sqrt(np.mean(np.sum(np.square(shifts), axis=1))))


def test_without_its_driver_a_tracker_has_no_latency_setting() -> None:
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
