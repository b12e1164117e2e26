"""The hot-spot by a Gaussian process over place and heading: each pulse where it tells most of the place of the peak.

The logarithm of the amplitude is a Gaussian process (C. E. Rasmussen, C. K. I. Williams, Gaussian Processes for Machine
Learning, 2006, chapter 2). Functions drawn from it after the pulses so far have their peaks where the hot-spot may be:
their mean is the estimate, their scatter its uncertainty. The next pulse is where the expected amplitude, seen over
these functions, explains most of that scatter beside its own noise: the expected reduction of a linear estimator's
variance, as in optimal design (K. Chaloner, I. Verdinelli, Statistical Science 10 (1995) 273). Hunting for place and
heading at once by a Gaussian process: Schultheiss et al., PLoS Comput. Biol. 22 (2026) e1013994; they draw, too.
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
"""How far away a place is half as good as unrelated, m: the field of a figure-of-eight coil falls like
``exp(-d^2 / (2 LENGTH^2))`` (`pcmrs_sim.tms.subject`)."""

HEADING_LENGTH = math.radians(70.0)
"""The same of headings: the threshold rises over it as over `LENGTH` (Richter et al. 2013)."""

REST_DECADES = -5.0
"""Where no response is, the amplitude is about 10 uV: the noise of an electromyogram."""

SPREAD_DECADES = 1.5
NOISE_DECADES = 0.4
"""Standard deviations, decades: of the map, and of one amplitude from pulse to pulse."""

LEAST = 1e-6
"""Amplitudes below it, V, say no more than that there is none."""

DRAWS = 200
SEED = 20130411
JITTER = 1e-6


class Peaks(NamedTuple):
    """Functions drawn after the pulses so far.

    Attributes:
        values: At every candidate, decades, (C, DRAWS).
        peaks: The candidate at which each is largest, as scaled place and heading, (DRAWS, 4).
        weights: How probable each is, by where hot-spots are expected, (DRAWS,).
        variances: Of the process at every candidate, decades squared, (C,).
    """

    values: Floats
    peaks: Floats
    weights: Floats
    variances: Floats


def proposal(chart: ScalpPatch, pulses: tuple[MapPulse, ...]) -> Transform:
    """The place and heading that tell most: the centre at first."""
    if not pulses:
        return chart.places[0]
    drawn = _draw(chart, pulses)
    deviations = drawn.values - (drawn.values @ drawn.weights)[:, None]
    shared = deviations @ (drawn.weights[:, None] * (drawn.peaks - drawn.weights @ drawn.peaks))
    told = np.sum(shared**2, axis=1) / (drawn.variances + NOISE_DECADES**2)
    return chart.poses[int(np.argmax(told))]


def estimate(chart: ScalpPatch, pulses: tuple[MapPulse, ...]) -> Hotspot:
    """The mean peak and its scatter, after at least one pulse."""
    drawn = _draw(chart, pulses)
    mean = drawn.weights @ drawn.peaks
    scatter = drawn.weights @ (drawn.peaks - mean) ** 2
    place, angle = mean[:3] * LENGTH, float(mean[3] * HEADING_LENGTH)
    return Hotspot(
        as_message(chart.pose(place, angle)),
        uncertainty=float(np.sqrt(scatter[:3].sum()) * LENGTH),
        heading_uncertainty=float(np.sqrt(scatter[3]) * HEADING_LENGTH),
    )


def expected(chart: ScalpPatch, pulses: Sequence[MapPulse], poses: Sequence[Transform]) -> Floats:
    """Median amplitudes that the process expects at poses, V, (K,): the map, for pictures."""
    mean, _ = condition(_features(chart, poses), *_data(chart, pulses))
    amplitudes: Floats = 10.0 ** (REST_DECADES + mean)
    return amplitudes


def condition(candidates: Floats, inputs: Floats, outputs: Floats) -> tuple[Floats, Floats]:
    """Mean (C,) and covariance (C, C) of the process at candidates (C, D), given noisy outputs (N,) at inputs (N, D).

    Rasmussen and Williams 2006, algorithm 2.1, with a squared exponential of length 1. By SciPy, since importing
    scikit-learn for it would hold up the daemon for longer than its heartbeat may fail.
    """
    noisy = _covariance(inputs, inputs) + NOISE_DECADES**2 * np.eye(len(inputs))
    factor = cholesky(noisy, lower=True)
    across = solve_triangular(factor, _covariance(inputs, candidates), lower=True)
    mean: Floats = across.T @ solve_triangular(factor, outputs, lower=True)
    return mean, _covariance(candidates, candidates) - across.T @ across


@lru_cache(maxsize=4)
def _draw(chart: ScalpPatch, pulses: tuple[MapPulse, ...]) -> Peaks:
    """The same draws for the same pulses: a search can be replayed."""
    candidates = _candidates(chart)
    normals = np.random.default_rng((SEED, len(pulses))).normal(size=(len(candidates), DRAWS))
    with _threads().limit(limits=1):  # so small matrices in several threads take 20 times as long on a busy machine
        mean, covariance = condition(candidates, *_data(chart, pulses))
        values = mean[:, None] + cholesky(covariance + JITTER * np.eye(len(candidates)), lower=True) @ normals
    peaks = candidates[np.argmax(values, axis=0)]
    return Peaks(values, peaks, _weights(chart, peaks), np.maximum(np.diag(covariance), 0.0))


def _weights(chart: ScalpPatch, peaks: Floats) -> Floats:
    """How probable peaks (K, 4) are before any pulse: hot-spots lie around the centre, normally distributed."""
    place, heading = chart.settings.prior_mm / 1e3 / LENGTH, math.radians(chart.settings.prior_deg) / HEADING_LENGTH
    deviations = (peaks - _features(chart, chart.places[:1])) / np.array((place, place, place, heading))
    squared = np.sum(deviations**2, axis=1)
    weights: Floats = np.exp(-0.5 * (squared - squared.min()))
    weights /= weights.sum()
    return weights


@cache
def _threads() -> Any:
    """Of the libraries for linear algebra; to look for these takes longer than to draw."""
    return ThreadpoolController()


@lru_cache(maxsize=4)
def _candidates(chart: ScalpPatch) -> Floats:
    return _features(chart, chart.poses)


def _data(chart: ScalpPatch, pulses: Sequence[MapPulse]) -> tuple[Floats, Floats]:
    """What the process learns from: scaled poses (N, 4), and decades above rest (N,)."""
    poses = [as_transform(pulse.image_from_coil) for pulse in pulses]
    amplitudes = np.array([max(pulse.amplitude, LEAST) for pulse in pulses])
    return _features(chart, poses), np.log10(amplitudes) - REST_DECADES


def _features(chart: ScalpPatch, poses: Sequence[Transform]) -> Floats:
    """Places and headings as the process sees them: in its own lengths, (K, 4)."""
    located = [chart.located(pose) for pose in poses]
    return np.array([(*(position / LENGTH), angle / HEADING_LENGTH) for position, angle in located])


def _covariance(a: Floats, b: Floats) -> Floats:
    """Of the process between inputs (N, D) and (M, D), decades squared, (N, M)."""
    covariance: Floats = SPREAD_DECADES**2 * np.exp(-0.5 * cdist(a, b, "sqeuclidean"))
    return covariance
