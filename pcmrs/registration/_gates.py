"""Gates of a registration. Each states the value, the limit, the reason and the remedy."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pcmrs.errors import ConfigurationError, MirroredPointsError
from pcmrs.registration._diagnosis import cycles
from pcmrs.registration._points import MIRROR_RATIO, PointRegistration
from pcmrs.registration.outliers import MIN_POINTS, OutlierTest

UNIT_RATIO = 10.0
"""Ratio of sizes, either way, from which on the digitized landmarks are in another unit than the planned ones."""


@dataclass(frozen=True)
class RegistrationLimits:
    """Limits that a registration must keep.

    Attributes:
        residual: Greatest mean distance of the landmarks after registration, m.
        sigma: Expected noise of a landmark, standard deviation per axis, m.
        tre: Greatest predicted rms error at the target, m.
        false_alarm: Share of good sets in which the mean-shift test may suspect a landmark.

    Raises:
        ConfigurationError: A length is not positive, or the share is not between 0 and 1.
    """

    residual: float
    sigma: float
    tre: float
    false_alarm: float = 0.01

    def __post_init__(self) -> None:
        for name in ("residual", "sigma", "tre"):
            if not 0.0 < getattr(self, name) < np.inf:
                text = f"The registration limit {name} is {getattr(self, name):g} m; give a positive length."
                raise ConfigurationError(text, limit=name, value=getattr(self, name))
        if not 0.0 < self.false_alarm < 1.0:
            text = f"The false-alarm rate is {self.false_alarm:g}; give a share between 0 and 1."
            raise ConfigurationError(text, limit="false_alarm", value=self.false_alarm)


@dataclass(frozen=True)
class RegistrationGate:
    """Result of one check that a registration must pass.

    Attributes:
        name: Name of the gate and code of its refusal: ``wrong_unit``, ``mirrored``, ``swapped_landmarks``,
            ``landmark_outlier``, ``residual_too_large`` or ``tre_too_large``.
        accepted: True if the registration passes.
        value: Measured value: a ratio, a number of landmarks, a test statistic, or a length in m.
        limit: Largest value that passes, in the same unit.
        text: Explanation with the value, the limit, the reason and the remedy.
    """

    name: str
    accepted: bool
    value: float
    limit: float
    text: str


def unit_gate(ratio: float) -> RegistrationGate:
    """Check that both sets of landmarks are in one unit. A ratio of 1000 or 1/1000 means mm for m.

    The value of the gate is the ratio or its inverse, whichever is larger.
    """
    either_way = max(ratio, 1.0 / ratio)
    accepted = either_way < UNIT_RATIO
    text = (
        f"The digitized landmarks are {ratio:.4g} times as far apart as the planned ones; more than {UNIT_RATIO:g} "
        "times, either way, is another unit."
    )
    if not accepted:
        which = "digitized" if ratio > 1.0 else "planned"
        thousand = 300.0 < either_way < 3000.0
        text += f" The {which} ones look like mm for m: give" if thousand else " Give"
        text += " both in m."
        if ratio < 1.0:
            text += " If they are, all were digitized at one place: touch each at its own."
    return RegistrationGate("wrong_unit", accepted, either_way, UNIT_RATIO, text)


def failed_mirror_gate(error: MirroredPointsError) -> RegistrationGate:
    """Return the gate of a registration that was refused because a mirror image fits far better."""
    return RegistrationGate("mirrored", False, error.fields["ratio"], MIRROR_RATIO, error.text)


def mirror_gate(registration: PointRegistration) -> RegistrationGate:
    """Return the passed gate of a registration.

    If a mirror image fitted far better, `register_points` would have refused the points.
    """
    text = (
        f"The best rotation leaves {registration.mirror_ratio:.2f} times as much as the best mirror image; more than "
        f"{MIRROR_RATIO:g} times is a flipped image, or left and right exchanged."
    )
    return RegistrationGate("mirrored", True, registration.mirror_ratio, MIRROR_RATIO, text)


def order_gate(permutation: tuple[int, ...] | None, residual: float, names: Sequence[str]) -> RegistrationGate:
    """Check that the landmarks were touched in the planned order.

    Args:
        permutation: Order as returned by `detect_order`.
        residual: Mean distance of the landmarks in the given order, m.
        names: Names of the landmarks, (N,).
    """
    if permutation is None:
        text = "Noise explains the landmarks in the planned order, or no exchange among them explains them better."
        return RegistrationGate("swapped_landmarks", True, 0.0, 0.0, text)
    rings = [[names[index] for index in ring] for ring in cycles(permutation)]
    exchanged = "; ".join(f"{', '.join(ring[:-1])} and {ring[-1]}" for ring in rings)
    text = (
        f"Landmarks were touched in another order than planned: {exchanged} are exchanged. As given, the mean residual "
        f"is {residual * 1e3:.2f} mm, more than noise; exchanged back, noise explains all of it. Digitize them again "
        "in the planned order."
    )
    return RegistrationGate("swapped_landmarks", False, float(sum(map(len, rings))), 0.0, text)


def outlier_gate(test: OutlierTest | None, sigma: float, false_alarm: float, names: Sequence[str]) -> RegistrationGate:
    """Check that no landmark is off by more than noise explains.

    Args:
        test: Result of the mean-shift test; None if there were too few landmarks for it.
        sigma: Noise of a landmark, standard deviation per axis, m.
        false_alarm: False-alarm rate of the test.
        names: Names of the landmarks, (N,).
    """
    if test is None:
        text = (
            f"Not tested: with fewer than {MIN_POINTS} landmarks, leaving any one out explains everything. Plan one "
            "more to have a wrong one named."
        )
        return RegistrationGate("landmark_outlier", True, 0.0, 0.0, text)
    worst = int(np.argmax(test.statistics))
    value = float(test.statistics[worst])
    text = (
        f"Without {names[worst]}, the sum of squared residuals over the variance falls by {value:.1f}; the limit is "
        f"{test.limit:.1f} (mean-shift test, chi-squared with 3 degrees of freedom, {false_alarm:.2g} false "
        f"alarms, noise {sigma * 1e3:.2f} mm per axis)."
    )
    if test.suspect is not None:
        text += f" Digitize {names[worst]} again."
    if test.rivals:
        rivals = ", ".join(names[index] for index in test.rivals)
        text += f" If that does not help: an error of {rivals} alone would explain the residuals about as well."
    return RegistrationGate("landmark_outlier", test.suspect is None, value, test.limit, text)


def residual_gate(
    registration: PointRegistration, limits: RegistrationLimits, names: Sequence[str]
) -> RegistrationGate:
    """Check that the mean distance of the landmarks is within its limit.

    Args:
        registration: Registration of the landmarks.
        limits: Limits that hold.
        names: Names of the landmarks, (N,).
    """
    accepted = registration.residual <= limits.residual
    text = (
        f"The registration residual is {registration.residual * 1e3:.2f} mm (mean distance of the landmarks), the "
        f"limit is {limits.residual * 1e3:.2f} mm."
    )
    if not accepted:
        worst = names[int(np.argmax(registration.distances))]
        text += f" The largest deviation is at {worst}. Digitize all landmarks again."
    return RegistrationGate("residual_too_large", accepted, registration.residual, limits.residual, text)


def tre_gate(tre: float, limits: RegistrationLimits, *, at_centroid: bool) -> RegistrationGate:
    """Check that the predicted error at the target is within its limit.

    Args:
        tre: Predicted rms error, m.
        limits: Limits that hold.
        at_centroid: True if no target is known and the error was predicted at the centroid of the landmarks.
    """
    accepted = tre <= limits.tre
    where = "the centroid of the landmarks, since no target is known yet" if at_centroid else "the target"
    text = (
        f"The predicted target registration error is {tre * 1e3:.2f} mm rms at {where}; the limit is "
        f"{limits.tre * 1e3:.2f} mm (Fitzpatrick, West, Maurer 1998; the residual does not show it)."
    )
    if not accepted:
        text += " Plan more landmarks, or some farther apart and around the target."
    return RegistrationGate("tre_too_large", accepted, tre, limits.tre, text)
