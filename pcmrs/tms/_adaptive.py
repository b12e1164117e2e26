"""Adaptive search for the hot-spot by a Gaussian process over place and heading.

Each pulse is placed where it tells most about the place of the peak. The logarithm of the amplitude is a Gaussian
process (C. E. Rasmussen, C. K. I. Williams, Gaussian Processes for Machine Learning, 2006, chapter 2). Functions drawn
from its posterior have their peaks where the hot-spot may be. The mean of these peaks is the estimate, and their
scatter is its uncertainty. The next pulse is where the amplitude explains most of that scatter relative to its own
variance: the expected reduction of a linear estimator's variance, as in optimal design (K. Chaloner, I. Verdinelli,
    Statistical
Science 10 (1995) 273). Schultheiss et al., PLoS Comput. Biol. 22 (2026) e1013994, also search place and heading
together by draws from a Gaussian process.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import cache, lru_cache
from typing import Any, NamedTuple

import numpy as np
from scipy.linalg import cholesky, solve_triangular
from scipy.spatial.distance import cdist
from threadpoolctl import ThreadpoolController  # type: ignore[import-untyped]

from pcmrs.spatial import Floats, Transform
from pcmrs.tms.scalp import ScalpPatch, as_message, as_transform
from pcmrs.tms.settings import Hotspot, MapPulse

LENGTH = 0.018
"""Length scale of places, m: the field of a figure-of-eight coil falls like ``exp(-d^2 / (2 LENGTH^2))``
(`pcmrs_sim.tms.subject`)."""

HEADING_LENGTH = math.radians(70.0)
"""Length scale of headings, rad: the threshold rises over it as over `LENGTH` (Richter et al. 2013)."""

REST_DECADES = -5.0
"""Mean of the process, decades of 1 V: without a response the amplitude is about 10 uV, the noise of an
electromyogram."""

SPREAD_DECADES = 1.5
"""Standard deviation of the map, decades."""

NOISE_DECADES = 0.4
"""Standard deviation of one amplitude from pulse to pulse, decades."""

MIN_AMPLITUDE = 1e-6
"""Least amplitude, V. Smaller ones only mean that there is no response, and zero has no logarithm."""

DRAWS = 200
SEED = 20130411
JITTER = 1e-6
"""Variance added to the diagonal so that rounding does not make a covariance indefinite, decades squared."""


class _Peaks(NamedTuple):
    """Functions drawn from the posterior after the pulses so far, and their peaks.

    Attributes:
        values: Values at every candidate, decades, (C, DRAWS).
        peaks: Candidate at which each function is largest, as scaled place and heading, (DRAWS, 4).
        weights: Prior probability of each peak, (DRAWS,).
        variances: Variance of the process at every candidate, decades squared, (C,).
    """

    values: Floats
    peaks: Floats
    weights: Floats
    variances: Floats


def next_pose(patch: ScalpPatch, pulses: tuple[MapPulse, ...]) -> Transform:
    """Return the pose of the next pulse, which tells most about the peak. The first pulse is at the centre.

    Args:
        patch: Places and headings of the search.
        pulses: Pulses so far.
    """
    if not pulses:
        return patch.places[0]
    drawn = _draw(patch, pulses)
    deviations = drawn.values - (drawn.values @ drawn.weights)[:, None]
    # Covariance of the amplitude at every candidate with the place of the peak, over the draws.
    shared = deviations @ (drawn.weights[:, None] * (drawn.peaks - drawn.weights @ drawn.peaks))
    # Reduction of the variance of a linear estimate of the peak by one noisy amplitude at each candidate.
    information = np.sum(shared**2, axis=1) / (drawn.variances + NOISE_DECADES**2)
    return patch.poses[int(np.argmax(information))]


def estimate(patch: ScalpPatch, pulses: tuple[MapPulse, ...]) -> Hotspot:
    """Return the mean peak and its scatter.

    Args:
        patch: Places and headings of the search.
        pulses: Pulses so far, at least one.
    """
    drawn = _draw(patch, pulses)
    mean = drawn.weights @ drawn.peaks
    scatter = drawn.weights @ (drawn.peaks - mean) ** 2
    place, angle = mean[:3] * LENGTH, float(mean[3] * HEADING_LENGTH)
    return Hotspot(
        as_message(patch.pose_at(place, angle)),
        uncertainty=float(np.sqrt(scatter[:3].sum()) * LENGTH),
        heading_uncertainty=float(np.sqrt(scatter[3]) * HEADING_LENGTH),
    )


def expected_amplitudes(patch: ScalpPatch, pulses: Sequence[MapPulse], poses: Sequence[Transform]) -> Floats:
    """Return the median amplitudes that the process expects at poses, V, (K,), as a map for pictures.

    Args:
        patch: Places and headings of the search.
        pulses: Pulses so far, at least one.
        poses: Poses ``image_from_coil``, (K,).
    """
    mean, _ = posterior(_features(patch, poses), *_data(patch, pulses))
    amplitudes: Floats = 10.0 ** (REST_DECADES + mean)
    return amplitudes


def posterior(candidates: Floats, inputs: Floats, outputs: Floats) -> tuple[Floats, Floats]:
    """Return mean (C,) and covariance (C, C) of the process at candidates, given noisy outputs at inputs.

    Rasmussen and Williams 2006, algorithm 2.1, with a squared exponential of length 1. It uses SciPy, because importing
    scikit-learn would block the daemon for longer than its heartbeat may fail.

    Args:
        candidates: Scaled places and headings of the candidates, (C, D).
        inputs: Scaled places and headings of the pulses, (N, D).
        outputs: Amplitudes of the pulses above rest, decades, (N,).
    """
    noisy = _covariance(inputs, inputs) + NOISE_DECADES**2 * np.eye(len(inputs))
    factor = cholesky(noisy, lower=True)
    across = solve_triangular(factor, _covariance(inputs, candidates), lower=True)
    mean: Floats = across.T @ solve_triangular(factor, outputs, lower=True)
    return mean, _covariance(candidates, candidates) - across.T @ across


@lru_cache(maxsize=4)
def _draw(patch: ScalpPatch, pulses: tuple[MapPulse, ...]) -> _Peaks:
    """Return draws from the posterior. They are the same for the same pulses, so that a search can be replayed."""
    candidates = _candidates(patch)
    normals = np.random.default_rng((SEED, len(pulses))).normal(size=(len(candidates), DRAWS))
    with _threads().limit(limits=1):  # on a busy machine, such small matrices take 20 times as long in several threads
        mean, covariance = posterior(candidates, *_data(patch, pulses))
        values = mean[:, None] + cholesky(covariance + JITTER * np.eye(len(candidates)), lower=True) @ normals
    peaks = candidates[np.argmax(values, axis=0)]
    return _Peaks(values, peaks, _weights(patch, peaks), np.maximum(np.diag(covariance), 0.0))


def _weights(patch: ScalpPatch, peaks: Floats) -> Floats:
    """Return the prior probability of peaks (K, 4): hot-spots are normally distributed around the centre."""
    place, heading = patch.settings.prior_mm / 1e3 / LENGTH, math.radians(patch.settings.prior_deg) / HEADING_LENGTH
    deviations = (peaks - _features(patch, patch.places[:1])) / np.array((place, place, place, heading))
    squared = np.sum(deviations**2, axis=1)
    # The common factor cancels. Without the subtraction all weights could underflow.
    weights: Floats = np.exp(-0.5 * (squared - squared.min()))
    weights /= weights.sum()
    return weights


@cache
def _threads() -> Any:
    """Return the control of the threads of the linear-algebra libraries.

    It is cached, because the search for these libraries takes longer than the draws.
    """
    return ThreadpoolController()


@lru_cache(maxsize=4)
def _candidates(patch: ScalpPatch) -> Floats:
    return _features(patch, patch.poses)


def _data(patch: ScalpPatch, pulses: Sequence[MapPulse]) -> tuple[Floats, Floats]:
    """Return the training data of the process: scaled poses (N, 4) and decades above rest (N,)."""
    poses = [as_transform(pulse.image_from_coil) for pulse in pulses]
    amplitudes = np.array([max(pulse.amplitude, MIN_AMPLITUDE) for pulse in pulses])
    return _features(patch, poses), np.log10(amplitudes) - REST_DECADES


def _features(patch: ScalpPatch, poses: Sequence[Transform]) -> Floats:
    """Return places and headings in units of the process's length scales, (K, 4)."""
    located = [patch.locate(pose) for pose in poses]
    return np.array([(*(position / LENGTH), angle / HEADING_LENGTH) for position, angle in located])


def _covariance(a: Floats, b: Floats) -> Floats:
    """Return the prior covariance of the process between inputs (N, D) and (M, D), decades squared, (N, M)."""
    covariance: Floats = SPREAD_DECADES**2 * np.exp(-0.5 * cdist(a, b, "sqeuclidean"))
    return covariance
