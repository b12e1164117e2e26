"""Settings of the offsets of surface points become priors, in m."""

from __future__ import annotations

from typing import Any

import msgspec
import pytest

from pcmrs.calibration import ToolType
from pcmrs.registration.surface import OffsetPrior
from pcmrs.workflows.settings import RegistrationSettings

HAIR = OffsetPrior("hair", 0.002, 0.003, 0.008)
FACE = OffsetPrior("face", 0.0, 0.001, 0.008)
EVERYWHERE = OffsetPrior("everywhere", 0.002, 0.003, 0.008)


@pytest.mark.parametrize(
    ("given", "tool", "priors"),
    [
        ({}, "coil", (HAIR, FACE)),
        ({}, "drill_guide", ()),
        ({"surface_offsets": "none"}, "coil", ()),
        ({"surface_offsets": "everywhere"}, "coil", (EVERYWHERE,)),
        ({"surface_offsets": "hair"}, "coil", (HAIR,)),
        ({"surface_offsets": "face"}, "coil", (FACE,)),
        ({"surface_offsets": "hair_and_face"}, "drill_guide", (HAIR, FACE)),
        (
            {"surface_offsets": "face", "surface_face_mm": -0.5, "surface_offset_limit_mm": 3.0},
            "coil",
            (OffsetPrior("face", -0.0005, 0.001, 0.003),),
        ),
    ],
)
def test_the_settings_name_the_offsets_to_estimate(
    given: dict[str, Any], tool: ToolType, priors: tuple[OffsetPrior, ...]
) -> None:
    assert msgspec.convert(given, RegistrationSettings).offset_priors(tool) == priors


@pytest.mark.parametrize(
    "given",
    [
        {"surface_hair_mm": 8.1},
        {"surface_face_mm": -8.1},
        {"surface_hair_mm": float("nan")},
        {"surface_offset_limit_mm": 1.9},
        {"surface_hair_sigma_mm": 0.0},
        {"surface_offsets": "beard"},
    ],
)
def test_offsets_that_make_no_sense_are_refused(given: dict[str, Any]) -> None:
    with pytest.raises(msgspec.ValidationError):
        msgspec.convert(given, RegistrationSettings)
