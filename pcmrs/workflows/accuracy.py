"""How noisy this pointer's landmarks are, and how accurate a registration is at a target by that."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence

import msgspec
import numpy as np

from pcmrs.errors import RefusalError
from pcmrs.registration import NoiseEstimate, RegistrationLimits, predict_tre
from pcmrs.registration.rigid import motion_jacobians
from pcmrs.spatial import Floats, Transform
from pcmrs.workflows.cell import Cell
from pcmrs.workflows.data import PlacementData, Registered, as_transform

MIN_NOISE_RATIO, MAX_NOISE_RATIO = 0.5, 1.5
"""Times the prior: no estimate leaves these bounds. What an accepted registration leaves over was accepted under the
noise in force then, so an estimate that fed on itself could grow step by step until it explains any wrong landmark;
and one that luck has made small would refuse good ones."""


def pointer_id(cell: Cell) -> str:
    """Short hash of the pointer's calibration: noise belongs to a pointer."""
    calibration = cell.pointer_calibration
    used = cell.settings.calibration.pointer_from_tip if calibration is None else calibration.content_hash()
    return hashlib.sha256(msgspec.json.encode(used)).hexdigest()[:16]


def active_noise_sigma(cell: Cell, data: PlacementData) -> float:
    """Deviation of a landmark per axis, m: of the prior and of this pointer's accepted registrations, bounded."""
    settings = cell.settings.registration
    prior = settings.sigma_mm / 1000.0
    estimate = data.noise.get(pointer_id(cell), NoiseEstimate())
    return float(
        np.clip(estimate.sigma(prior, settings.sigma_degrees), MIN_NOISE_RATIO * prior, MAX_NOISE_RATIO * prior)
    )


def learn_noise(cell: Cell, data: PlacementData, distances: Floats) -> dict[str, NoiseEstimate]:
    """The estimates after an accepted registration that left `distances` (N,), m.

    One plan counts once, however often it is digitized: most of the noise is where the plan has the landmarks, and that
    is the same each time.
    """
    previous = data.previous
    if previous is not None and previous.landmarks == data.landmarks:
        return data.noise
    pointer = pointer_id(cell)
    known = data.noise.get(pointer, NoiseEstimate())
    return data.noise | {pointer: known.with_residuals(distances, len(distances))}


def active_limits(cell: Cell, data: PlacementData) -> RegistrationLimits:
    """What a registration must keep now."""
    settings = cell.settings.registration
    return RegistrationLimits(
        residual=settings.residual_limit_mm / 1000.0,
        sigma=active_noise_sigma(cell, data),
        tre=settings.tre_limit_mm / 1000.0,
        false_alarm=settings.false_alarm,
    )


def tre_at(cell: Cell, data: PlacementData, registered: Registered, target: Floats) -> float:
    """Predicted rms error of a registration at a target in the image (3,), m."""
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
    """Predicted rms error of a registration at targets in the image (M, 3), m, (M,).

    Args:
        landmarks: That it was made of, in the image, m, (N, 3).
        body_ref_from_image: The registration.
        covariance: Of `Registered`: empty where no surface has refined it.
        sigma: Of `active_noise_sigma`, m; counts where it is empty.
        targets: m.
    """
    if not covariance:
        return predict_tre(landmarks, targets, sigma)
    jacobians = motion_jacobians(body_ref_from_image @ targets)
    motion = np.array(covariance).reshape(6, 6)
    tre: Floats = np.sqrt(np.einsum("mij,jk,mik->m", jacobians, motion, jacobians))
    return tre


def check_tre(cell: Cell, data: PlacementData, target: Floats) -> float | None:
    """Refuses a target at which the registration in force is not accurate enough; returns its predicted error, m.

    Without a registration there is nothing to predict yet: None.

    Raises:
        RefusalError: ``tre_too_large``.
    """
    if data.registered is None:
        return None
    tre, limit = tre_at(cell, data, data.registered, target), cell.settings.registration.tre_limit_mm / 1000.0
    if not tre <= limit:
        text = (
            f"The predicted target registration error is {tre * 1e3:.2f} mm rms at the planned pose; the limit is "
            f"{limit * 1e3:.2f} mm. Plan more landmarks, or some farther apart and around the target, or refine the "
            "registration by the surface."
        )
        raise RefusalError("tre_too_large", text, tre=tre, limit=limit)
    return tre
