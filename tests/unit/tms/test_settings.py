"""Settings of searches and hunts that cannot be meant are refused."""

from __future__ import annotations

import msgspec
import pytest

from pcmrs.tms.settings import HotspotSettings, ThresholdSettings


@pytest.mark.parametrize(
    "given",
    [
        {"method": "random"},
        {"spacing_mm": 0.0},
        {"rings": 0},
        {"rings": 7},
        {"rings": 6, "heading_step_deg": 5.0},
        {"min_pulses": 50, "max_pulses": 40},
        {"pulses_per_place": 0},
        {"uncertainty_mm": -1.0},
        {"seed": 1},
    ],
)
def test_settings_that_make_no_search_are_refused(given: dict[str, object]) -> None:
    with pytest.raises(msgspec.ValidationError):
        msgspec.convert(given, HotspotSettings)


@pytest.mark.parametrize(
    "values",
    [{"ceiling": 8.0}, {"ceiling": 101.0}, {"interval": 0.0}, {"method": "guess"}, {"noise_uv": 60.0}, {"colour": 1}],
)
def test_settings_that_make_no_sense_are_refused(values: dict[str, object]) -> None:
    with pytest.raises(msgspec.ValidationError):
        msgspec.convert(values, ThresholdSettings)
