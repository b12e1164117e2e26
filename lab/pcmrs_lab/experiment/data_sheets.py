"""Noise, latency and rate of trackers, and repeatability of an arm, as settings of the simulated devices.

The makers give the accuracy of a single marker, as a 3D rms over the measuring volume. It has a part that differs from
frame to frame, and a part that stays as long as a body rests. The first was measured by others (`_JITTER`); the second
is what is left of the sum of squares.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal, get_args

from pcmrs_sim.error_models import BASELINE

TrackerName = Literal["vicra", "vega", "spectra"]
"""Trackers of Northern Digital: Polaris Vicra, Vega ST and Spectra."""
NAMES: tuple[TrackerName, ...] = get_args(TrackerName)

ARM_REPEATABILITY_MM = 0.15
"""Pose repeatability of the LBR iiwa 14 R820 by ISO 9283, from its data sheet, mm."""
_DISTANCE = 1.2
"""Distance from the tracker at which the jitter of a tool is that of the sheet, m: that of the simulated cell."""
_MARKERS = 4
_BIAS_DEG_PER_MM = 0.3
"""Rotation of a marker body by an error that hardly changes over its size, relative to that error: as in the defaults
of ``sim.tracker``."""


@dataclass(frozen=True, slots=True)
class TrackerSheet:
    """Values of a tracker.

    Attributes:
        accuracy_mm: 3D rms error of a single marker, from the maker's user guide or data sheet, mm.
        rate_hz: Frames per second, from the same.
        latency: Time from the exposure until the pose is available, s.
    """

    accuracy_mm: float
    rate_hz: float
    latency: float


SHEETS: dict[TrackerName, TrackerSheet] = {
    "vicra": TrackerSheet(accuracy_mm=0.25, rate_hz=20.0, latency=0.050),
    "vega": TrackerSheet(accuracy_mm=0.12, rate_hz=60.0, latency=0.014),
    "spectra": TrackerSheet(accuracy_mm=0.25, rate_hz=60.0, latency=0.016),
}
"""The latency of Vega was measured (14.2 ± 1.8 ms, Radiation Oncology 16, 2021, doi 10.1186/s13014-021-01804-7), and
that of Spectra found hardly longer there. That of Vicra is assumed to be one frame."""
_JITTER: dict[TrackerName, float] = {"vicra": 0.10, "vega": 0.05, "spectra": 0.08}
"""3D rms jitter of a tool at rest, mm: 0.08 to 0.10 for four infrared trackers (Computer Assisted Surgery, 2023, doi
10.1080/24699322.2023.2275522). That of Vega is assumed to be in proportion to its accuracy."""


def data_sheet_settings(name: TrackerName, *, virtual: bool) -> list[str]:
    """Return the settings of a cell whose simulated devices have the values of their data sheets.

    Args:
        name: Name of the tracker.
        virtual: True if the driver of the real tracker reads it; its latency is then configured, too.
    """
    sheet = SHEETS[name]
    # Of a sphere: along two axes across its line of sight, and along it (`pcmrs_sim.error_models.TrackerErrors`).
    of_sphere = math.hypot(_DISTANCE, _DISTANCE, 2.0 * _DISTANCE**2 / BASELINE)
    jitter_mm = _JITTER[name] * math.sqrt(_MARKERS) / of_sphere  # the mean of all markers is steadier than each
    bias_mm = math.sqrt(sheet.accuracy_mm**2 - _JITTER[name] ** 2)
    settings = {
        "sim.tracker.rate_hz": sheet.rate_hz,
        "sim.tracker.latency": sheet.latency,
        "sim.tracker.jitter_mm": round(jitter_mm, 4),
        "sim.tracker.bias_mm": round(bias_mm, 4),
        "sim.tracker.bias_deg": round(_BIAS_DEG_PER_MM * bias_mm, 4),
        "sim.arm.repeatability_mm": ARM_REPEATABILITY_MM,
        "procedure.placement.repeatability_mm": ARM_REPEATABILITY_MM,
    }
    if virtual:
        settings["ndi.latency"] = sheet.latency
    return [f"{key}={value:g}" for key, value in settings.items()]
