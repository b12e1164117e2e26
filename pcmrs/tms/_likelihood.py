"""Motor threshold by maximum likelihood, with the next pulse at the most likely threshold.

Awiszus, TMS and threshold hunting, Suppl. Clin. Neurophysiol. 56 (2003) 13: the probability of a response is a
cumulative Gaussian of the intensity, with the threshold as its mean and 0.07 of it as its standard deviation. A prior
takes the place of his two virtual pulses, no response to 0 % and one to 100 %.

Known amplitudes tell by how much a pulse was above or below the threshold. Their logarithm is assumed to be linear in
the same Gaussian variable between the noise and `TOP` times a response (a censored regression: Tobin, Econometrica 26
(1958) 24), and a response at the threshold to have its least amplitude. The slope is unknown and is averaged over.
Responses without amplitudes tell nothing about the slope, and the result is that of Awiszus.
"""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np
from scipy.special import log_ndtr, logsumexp

from pcmrs.spatial import Floats
from pcmrs.tms.settings import Estimate, EstimatorState, Pulse, ThresholdSettings

SPREAD = 0.07
"""Standard deviation of the Gaussian as a share of the threshold (Awiszus 2003)."""

TOP = 4.0
"""Multiple of the least amplitude of a response above which the logarithm levels off. A larger amplitude only counts as
above."""

THRESHOLDS = np.arange(1.0, 150.0, 0.25)[:, None]
"""Grid of thresholds, percent of the maximum stimulator output, (T, 1). Those above 100 are out of reach of any
pulse."""

SLOPES = np.geomspace(0.15, 3.0, 10)
"""Grid of slopes, decades of the amplitude per standard deviation of the Gaussian, (S,)."""

TAIL = 0.025
"""Probability beyond each end of the interval of 95 %."""


@lru_cache(maxsize=256)
def estimator_state(settings: ThresholdSettings, pulses: tuple[Pulse, ...]) -> EstimatorState:
    """Return the estimated threshold after some pulses, the next intensity, and the decision about the end.

    Args:
        settings: Settings of the threshold hunt.
        pulses: Pulses so far.
    """
    estimate, low, high = _estimate(settings, pulses)
    ceiling = math.floor(settings.ceiling)
    certain = high - low <= settings.interval * estimate
    refusal = None
    # The prior alone must not refuse a hunt.
    if pulses and (low > ceiling or (certain and estimate > ceiling)):
        refusal = "above_ceiling"
    elif pulses and (high < settings.floor or (certain and estimate <= settings.floor)):
        refusal = "below_floor"
    return EstimatorState(
        estimate=Estimate(estimate, low, high),
        intensity=float(min(max(round(estimate), 1), ceiling)),
        finished=certain and refusal is None,
        refusal=refusal,
    )


def _estimate(settings: ThresholdSettings, pulses: tuple[Pulse, ...]) -> tuple[float, float, float]:
    """Return the most probable threshold and the ends of its interval of 95 %, percent of the output."""
    log_posterior = logsumexp(_log_joint(settings, pulses), axis=1)
    distribution = np.cumsum(np.exp(log_posterior - logsumexp(log_posterior)))
    low, high = THRESHOLDS[np.searchsorted(distribution, (TAIL, 1.0 - TAIL)), 0]
    return float(THRESHOLDS[np.argmax(log_posterior), 0]), float(low), float(high)


@lru_cache(maxsize=256)
def _log_joint(settings: ThresholdSettings, pulses: tuple[Pulse, ...]) -> Floats:
    """Return the logarithm of prior and likelihood for every threshold and slope, (T, S).

    The cache holds the result for the earlier pulses, so that each pulse is evaluated once.
    """
    if not pulses:
        deviations = (THRESHOLDS - settings.prior_mean) / settings.prior_sd
        return np.repeat(-0.5 * deviations**2, len(SLOPES), axis=1)
    return _log_joint(settings, pulses[:-1]) + _log_likelihood(settings, pulses[-1])


def _log_likelihood(settings: ThresholdSettings, pulse: Pulse) -> Floats:
    """Return the log-likelihood of one pulse up to a constant, for every threshold and slope, (T, S) or (T, 1).

    Args:
        settings: Settings of the threshold hunt.
        pulse: Pulse with its response.
    """
    deviation = (pulse.intensity - THRESHOLDS) / (SPREAD * THRESHOLDS)
    # Only yes or no is known: the likelihood of Awiszus.
    if pulse.amplitude is None:
        return np.asarray(log_ndtr(deviation if pulse.responded else -deviation))
    floor, top = settings.noise_uv / settings.response_uv, TOP
    size = pulse.amplitude * 1e6 / settings.response_uv
    above = math.log10(min(max(size, floor), top)) / SLOPES - deviation
    # Within the noise, the amplitude is only known to be below it.
    if size <= floor:
        return np.asarray(log_ndtr(above))
    # Beyond the linear range, the amplitude is only known to be above it.
    if size >= top:
        return np.asarray(log_ndtr(-above))
    return np.asarray(-0.5 * above**2 - np.log(SLOPES))
