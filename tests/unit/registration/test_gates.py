"""Gates of a registration: the value is compared with the limit, and the text says both and what to do."""

from __future__ import annotations

import numpy as np
import pytest

from pcmrs.errors import ConfigurationError, MirroredPointsError
from pcmrs.registration import register_points
from pcmrs.registration._gates import (
    UNIT_RATIO,
    RegistrationLimits,
    failed_mirror_gate,
    mirror_gate,
    order_gate,
    outlier_gate,
    residual_gate,
    tre_gate,
    unit_gate,
)
from pcmrs.registration.outliers import OutlierTest
from tests.unit.registration.landmark_layouts import HEAD, HEAD_NAMES

LIMITS = RegistrationLimits(residual=0.004, sigma=0.00186, tre=0.004)


@pytest.mark.parametrize(
    ("ratio", "accepted", "words"),
    [
        (1.0, True, ""),
        (9.9, True, ""),
        (1.0 / 9.9, True, ""),
        (1000.0, False, "The digitized ones look like mm"),
        (0.001, False, "The planned ones look like mm"),
        (UNIT_RATIO, False, "Give both in m"),
        (0.01, False, "all were digitized at one place"),
    ],
)
def test_ratio_of_units_counts_either_way(ratio: float, accepted: bool, words: str) -> None:
    gate = unit_gate(ratio)
    assert gate.accepted == accepted
    assert gate.value == pytest.approx(max(ratio, 1.0 / ratio))
    assert gate.limit == UNIT_RATIO
    assert words in gate.text


def test_mirror_gate_has_the_ratio_of_the_fit_or_of_its_refusal() -> None:
    passed = mirror_gate(register_points(HEAD, HEAD + 0.001 * np.eye(6, 3)))
    with pytest.raises(MirroredPointsError) as refused:
        register_points(HEAD, HEAD * (-1.0, 1.0, 1.0))
    failed = failed_mirror_gate(refused.value)
    assert (passed.name, passed.accepted) == ("mirrored", True)
    assert (failed.name, failed.accepted) == ("mirrored", False)
    assert passed.value <= passed.limit == failed.limit < failed.value


@pytest.mark.parametrize(
    ("order", "exchanged", "value"),
    [
        ((1, 0, 2, 3, 4, 5), "nasion and nose_tip are exchanged", 2),
        ((1, 0, 2, 3, 5, 4), "nasion and nose_tip; left_tragus and right_tragus are exchanged", 4),
        ((1, 2, 0, 3, 4, 5), "nasion, nose_tip and left_outer_canthus are exchanged", 3),
    ],
)
def test_exchanged_landmarks_are_named_in_their_rings(order: tuple[int, ...], exchanged: str, value: int) -> None:
    gate = order_gate(order, 0.0123, HEAD_NAMES)
    assert not gate.accepted
    assert exchanged in gate.text
    assert "12.30 mm" in gate.text
    assert gate.value == value > gate.limit
    assert order_gate(None, 0.0123, HEAD_NAMES).accepted


def test_suspect_and_its_rivals_are_named() -> None:
    statistics = np.array((1.0, 2.0, 40.0, 38.0, 3.0, 4.0))
    gate = outlier_gate(OutlierTest(statistics, 16.3, 2, (3,)), 0.00186, 0.01, HEAD_NAMES)
    assert (gate.accepted, gate.value, gate.limit) == (False, 40.0, 16.3)
    assert "Digitize left_outer_canthus again" in gate.text
    assert "an error of right_outer_canthus alone" in gate.text
    unsuspected = outlier_gate(OutlierTest(statistics / 10.0, 16.3, None, ()), 0.00186, 0.01, HEAD_NAMES)
    assert unsuspected.accepted
    assert "again" not in unsuspected.text


@pytest.mark.parametrize(("shift", "accepted"), [(0.002, True), (0.030, False)])
def test_residual_gate_names_the_largest_deviation(shift: float, accepted: bool) -> None:
    moved = HEAD.copy()
    moved[4, 1] += shift
    registration = register_points(moved, HEAD)
    gate = residual_gate(registration, LIMITS, HEAD_NAMES)
    assert gate.accepted == accepted == (registration.residual <= LIMITS.residual)
    assert f"{registration.residual * 1000:.2f} mm" in gate.text
    assert ("largest deviation is at left_tragus" in gate.text) == (not accepted)


@pytest.mark.parametrize("at_centroid", [True, False])
def test_target_error_at_its_limit_is_accepted(at_centroid: bool) -> None:
    assert tre_gate(LIMITS.tre, LIMITS, at_centroid=at_centroid).accepted
    gate = tre_gate(LIMITS.tre + 1e-9, LIMITS, at_centroid=at_centroid)
    assert not gate.accepted
    assert ("centroid" in gate.text) == at_centroid
    assert not tre_gate(np.nan, LIMITS, at_centroid=at_centroid).accepted


@pytest.mark.parametrize("name", ["residual", "sigma", "tre"])
@pytest.mark.parametrize("value", [0.0, -0.001, np.inf, np.nan])
def test_limits_must_be_positive_lengths(name: str, value: float) -> None:
    values = {"residual": 0.004, "sigma": 0.002, "tre": 0.004} | {name: value}
    with pytest.raises(ConfigurationError, match=f"limit {name} is") as refused:
        RegistrationLimits(**values)
    assert refused.value.fields["limit"] == name
