"""Verdict on a registration: the decision about its use, and all gates that justify it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from pcmrs.errors import GeometryError, MirroredPointsError
from pcmrs.registration._accuracy import predict_tre
from pcmrs.registration._diagnosis import detect_order, unit_ratio
from pcmrs.registration._gates import (
    RegistrationGate,
    RegistrationLimits,
    failed_mirror_gate,
    mirror_gate,
    order_gate,
    outlier_gate,
    residual_gate,
    tre_gate,
    unit_gate,
)
from pcmrs.registration._points import (
    PointRegistration,
    checked_covariances,
    checked_pairs,
    checked_point,
    register_points,
)
from pcmrs.registration.outliers import MIN_POINTS, mean_shift_test
from pcmrs.spatial import Floats


@dataclass(frozen=True, eq=False)
class RegistrationVerdict:
    """Decision about the use of a registration, with its reasons.

    Attributes:
        registration: Transform ``body_ref_from_image`` and its residuals; None if no registration makes sense.
        gates: Gates in the order of their checks. A wrong unit, a mirror image or a wrong order ends the checks,
            because it explains all later failures.
        tre: Predicted rms error at the target, m.
        suspect: Index of the one landmark to digitize again.
        permutation: For each digitized landmark the index of its planned one, if they were exchanged.
    """

    registration: PointRegistration | None
    gates: tuple[RegistrationGate, ...]
    tre: float | None = None
    suspect: int | None = None
    permutation: tuple[int, ...] | None = None

    @property
    def accepted(self) -> bool:
        """True if every gate passes."""
        return self.refusal is None

    @property
    def refusal(self) -> RegistrationGate | None:
        """First gate that does not pass, or None."""
        return next((gate for gate in self.gates if not gate.accepted), None)


def judge(
    planned: npt.ArrayLike,
    digitized: npt.ArrayLike,
    limits: RegistrationLimits,
    *,
    names: Sequence[str],
    target: npt.ArrayLike | None,
    covariances: npt.ArrayLike | None = None,
) -> RegistrationVerdict:
    """Register, and decide whether the result may be used.

    Args:
        planned: Landmarks in the image, m, (N, 3).
        digitized: The same landmarks in body_ref, in the same order, m, (N, 3).
        limits: Limits that the registration must keep.
        names: Names of the landmarks, (N,).
        target: Point in the image at which the error is predicted, m, (3,); None for the centroid of the landmarks.
        covariances: Covariances of the digitized landmarks' noise in body_ref, m^2, (N, 3, 3); by default
            ``limits.sigma`` in every axis.

    Raises:
        GeometryError: Shapes are wrong, a number is not finite, or a covariance is not positive definite.
        DegeneratePointsError: The planned or the digitized landmarks do not determine a rotation.
    """
    digitized, planned = checked_pairs(digitized, planned)
    _check_names(names, len(planned))
    target_image = None if target is None else checked_point(target, "target")
    noise = limits.sigma if covariances is None else checked_covariances(covariances, len(planned))
    sigma = _sigma(noise)
    unit = unit_gate(unit_ratio(planned, digitized))
    if not unit.accepted:
        return RegistrationVerdict(None, (unit,))
    try:
        registration = register_points(digitized, planned, covariances=covariances)
    except MirroredPointsError as error:
        return RegistrationVerdict(None, (unit, failed_mirror_gate(error)))
    permutation = detect_order(planned, digitized, sigma, limits.false_alarm)
    order = order_gate(permutation, registration.residual, names)
    # The later gates would only repeat the wrong order in other words.
    if permutation is not None:
        return RegistrationVerdict(registration, (unit, mirror_gate(registration), order), permutation=permutation)
    testable = len(planned) >= MIN_POINTS
    outlier = mean_shift_test(digitized, planned, noise, limits.false_alarm) if testable else None
    tre = _tre(registration, planned, target_image, noise)
    gates = (
        unit,
        mirror_gate(registration),
        order,
        outlier_gate(outlier, sigma, limits.false_alarm, names),
        residual_gate(registration, limits, names),
        tre_gate(tre, limits, at_centroid=target is None),
    )
    return RegistrationVerdict(registration, gates, tre, suspect=outlier.suspect if outlier else None)


def _check_names(names: Sequence[str], count: int) -> None:
    if len(names) != count:
        text = f"There are {len(names)} names of {count} landmarks; give one of each."
        raise GeometryError(text, names=len(names), landmarks=count)


def _sigma(noise: float | Floats) -> float:
    """Return the standard deviation per axis of an isotropic noise of the same size, m."""
    return noise if isinstance(noise, float) else float(np.sqrt(np.mean(np.diagonal(noise, axis1=1, axis2=2))))


def _tre(registration: PointRegistration, planned: Floats, target: Floats | None, noise: float | Floats) -> float:
    """Return the predicted rms error at a target in the image (3,), m, or at the centroid of the landmarks.

    It is computed in body_ref, the frame of the covariances.
    """
    body_ref_from_image = registration.fixed_from_moving
    at = body_ref_from_image @ (planned.mean(axis=0) if target is None else target)
    return float(predict_tre(body_ref_from_image @ planned, at, noise)[0])
