"""Noise of this pointer's landmarks, and the resulting accuracy of a registration at a target."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from pcmrs.errors import RefusalError
from pcmrs.registration import NoiseEstimate, RegistrationLimits, predict_tre
from pcmrs.registration.rigid import motion_jacobians
from pcmrs.spatial import Floats, Transform
from pcmrs.workflows.cell import Cell
from pcmrs.workflows.data import PlacementData, Registered, as_transform

MIN_NOISE_RATIO, MAX_NOISE_RATIO = 0.5, 1.5
"""Bounds of the estimated noise, relative to the prior. Residuals are learned only from registrations that were
accepted with the estimate at that time, so an unbounded estimate could grow step by step until it explains any wrong
landmark. An estimate that is small by chance would refuse good landmarks."""


def pointer_id(cell: Cell) -> str:
    """Return a short hash of the pointer's calibration, because the noise belongs to a pointer."""
    return cell.mounting.pointer_identity


def active_noise_sigma(cell: Cell, data: PlacementData) -> float:
    """Return the noise of a landmark, standard deviation per axis, m.

    It is pooled from the prior and this pointer's accepted registrations, and bounded.

    Args:
        cell: Cell with the pointer and the settings.
        data: Data of the procedure.
    """
    settings = cell.settings.registration
    prior = settings.sigma_mm / 1000.0
    estimate = data.noise.get(pointer_id(cell), NoiseEstimate())
    return float(
        np.clip(estimate.sigma(prior, settings.sigma_degrees), MIN_NOISE_RATIO * prior, MAX_NOISE_RATIO * prior)
    )


def learn_noise(cell: Cell, data: PlacementData, distances: Floats) -> dict[str, NoiseEstimate]:
    """Return the noise estimates after an accepted registration.

    One plan counts once, however often it is digitized. Most of the noise is the plan's error in the positions of the
    landmarks, which is the same each time.

    Args:
        cell: Cell with the pointer.
        data: Data of the procedure before the registration.
        distances: Distances of the landmarks after registration, m, (N,).
    """
    previous = data.previous
    if previous is not None and previous.landmarks == data.landmarks:
        return data.noise
    pointer = pointer_id(cell)
    known = data.noise.get(pointer, NoiseEstimate())
    return data.noise | {pointer: known.with_residuals(distances, len(distances))}


def active_limits(cell: Cell, data: PlacementData) -> RegistrationLimits:
    """Return the limits that a registration must keep now.

    Args:
        cell: Cell with the settings.
        data: Data of the procedure.
    """
    settings = cell.settings.registration
    return RegistrationLimits(
        residual=settings.residual_limit_mm / 1000.0,
        sigma=active_noise_sigma(cell, data),
        tre=settings.tre_limit_mm / 1000.0,
        false_alarm=settings.false_alarm,
    )


def tre_at(cell: Cell, data: PlacementData, registered: Registered, target: Floats) -> float:
    """Return the predicted rms error of a registration at a target, m.

    Args:
        cell: Cell with the pointer and the settings.
        data: Data of the procedure.
        registered: Registration to judge.
        target: Target in the image, m, (3,).
    """
    landmarks = np.array([landmark.position for landmark in registered.landmarks])
    body_ref_from_image, covariance = as_transform(registered.body_ref_from_image), registered.covariance
    return float(tre_over(landmarks, body_ref_from_image, covariance, active_noise_sigma(cell, data), target[None])[0])


def tre_over(
    landmarks: Floats,
    body_ref_from_image: Transform,
    covariance: Sequence[float],
    sigma: float,
    targets: Floats,
) -> Floats:
    """Return the predicted rms errors of a registration at targets, m, (M,).

    Args:
        landmarks: Landmarks of the registration in the image, m, (N, 3).
        body_ref_from_image: Registration.
        covariance: Covariance of `Registered`; empty if no surface has refined the registration.
        sigma: Noise of a landmark as from `active_noise_sigma`, m; used if `covariance` is empty.
        targets: Targets in the image, m, (M, 3).
    """
    if not covariance:
        return predict_tre(landmarks, targets, sigma)
    jacobians = motion_jacobians(body_ref_from_image @ targets)
    motion = np.array(covariance).reshape(6, 6)
    tre: Floats = np.sqrt(np.einsum("mij,jk,mik->m", jacobians, motion, jacobians))
    return tre


def check_tre(cell: Cell, data: PlacementData, target: Floats) -> float | None:
    """Refuse a target at which registration and tool together are not accurate enough.

    The errors of the registration and of the calibrated contact point are independent, so that their squares add.

    Args:
        cell: Cell with the pointer and the settings.
        data: Data of the procedure.
        target: Target in the image, m, (3,).

    Returns:
        Predicted rms error of the contact point at the target, m; None without a registration, because then there is
        nothing to predict.

    Raises:
        RefusalError: ``tre_too_large``.
    """
    if data.registered is None:
        return None
    registration, tip = tre_at(cell, data, data.registered, target), cell.mounting.tip_error
    tre, limit = math.hypot(registration, tip), cell.settings.registration.tre_limit_mm / 1000.0
    if not tre <= limit:
        text = (
            f"The predicted error at the planned pose is {tre * 1e3:.2f} mm rms: {registration * 1e3:.2f} mm by the "
            f"registration, {tip * 1e3:.2f} mm by the tool's contact point; the limit is {limit * 1e3:.2f} mm. Plan "
            "more landmarks, or some farther apart and around the target, or refine the registration by the surface, "
            "or calibrate the contact point again."
        )
        raise RefusalError("tre_too_large", text, tre=tre, limit=limit, tip=tip)
    return tre
