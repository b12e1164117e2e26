"""Results of commands as a person reads them."""

from __future__ import annotations

from typing import Any

import pytest

from pcmrs.cli.quantities import readable


@pytest.mark.parametrize(
    ("result", "text"),
    [
        ({"distance": 5.09979291328536e-05, "landmark": "nose_tip"}, "distance 0.05 mm, landmark nose_tip"),
        ({"tre": 0.002825594204422013}, "tre 2.83 mm"),
        ({"distance": 0.6597739994253375, "clearance": 0.28}, "distance 659.77 mm, clearance 280.00 mm"),
        ({"distance": 1e-7}, "distance 0.0001 mm"),
        ({"turn_deg": 0.026361340481239955, "shift_mm": 0.1337}, "turn_deg 0.03°, shift_mm 0.13 mm"),
        ({"points": 30, "witness": True, "reason": None}, "points 30, witness yes, reason not known"),
        ({"spreads": {"nasion": 0.00011454793433450587}}, "spreads (nasion 0.11 mm)"),
        ({"calibration": {"tool": "explicit", "age_s": 3.0}}, "calibration (tool explicit, age_s 3.00 s)"),
        ({"position": [0.11913, 0.0, -0.0247]}, "position (119.13, 0.00, -24.70) mm"),
        ({"gates": [{"name": "wrong_unit"}, {"name": "order"}]}, "gates (2)"),
        ({"intensity": 50.0}, "intensity 50.00"),
        ({"force": 3.0, "asked": 3.0}, "force 3.00 N, asked 3.00 N"),
        (
            {"translation_error": 5.63e-05, "rotation_error": 0.000274},
            "translation_error 0.06 mm, rotation_error 0.02°",
        ),
        ({"tolerance": {"mm": 0.08, "noise_deg": 0.00346}}, "tolerance (mm 0.08 mm, noise_deg 0.00346°)"),
        ({}, ""),
    ],
)
def test_a_result_has_units_and_few_digits(result: dict[str, Any], text: str) -> None:
    assert readable(result) == text
