"""Amplitude of a motor evoked potential: recruitment by the stimulus, with variability before and after it.

Model and population are those of Goetz, Alavi, Deng, Peterchev, Statistical Model of Motor-Evoked Potentials, IEEE
Trans. Neural Syst. Rehabil. Eng. 27 (2019) 1539, with the two sources of variability of Goetz, Luber, Lisanby,
Peterchev, Brain Stimul. 7 (2014) 541. A sigmoid leads from the intensity to the logarithm of the amplitude; noise is
added to both, and the noise of the measurement to the amplitude. The parameters are those that the authors publish with
their code. Thresholds are estimated with another model.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import numpy.typing as npt

from pcmrs.spatial import Floats

RESPONSE = 50e-6
"""Smallest peak-to-peak amplitude of a response, V: Rossini et al., Clin. Neurophysiol. 126 (2015) 1071."""

LOWEST = 1e-7
"""Lower asymptote of the sigmoid of the amplitude, V."""

THRESHOLDS = (30.0, 100.0)
"""Range of measurable thresholds, percent of the maximum stimulator output: Wang, Peterchev, Goetz, J. Neural Eng. 20
(2023)."""

CURVE_MEAN = np.array([3.646550162125, 0.426390035500, 1.666487134750])
CURVE_COVARIANCE = np.array(
    [
        [7.202738820058, 0.569742608764, -0.197461987887],
        [0.569742608764, 0.047425817251, -0.015113039713],
        [-0.197461987887, -0.015113039713, 0.007107112788],
    ]
)
"""Mean and covariance of the decimal logarithms of half, steepness and onset in the population: Goetz et al. 2019."""

OUTPUT_NODES = np.polynomial.hermite_e.hermegauss(15)
"""Nodes and weights of Gauss-Hermite quadrature over the output's variability."""
NOISE_QUANTILES = (np.arange(15) + 0.5) / 15
"""Quantiles of the measurement's noise over which probabilities are averaged."""


@dataclass(frozen=True)
class Recruitment:
    """One subject; the defaults are the middle of the population.

    Attributes:
        threshold: Intensity at which half of the pulses give a response of `RESPONSE`, percent of the maximum
            stimulator output.
        range_decades: Range of the amplitude from no to full recruitment of the muscle, decades.
        half: Constant of the sigmoid ``1 / (1 + half / x**steepness)``, with x the intensity above the onset, percent.
        steepness: Exponent of that sigmoid.
        input_spread: Standard deviation of the excitation, percent of the maximum stimulator output.
        output_spread: Standard deviation of the amplitude at a given excitation, decades.
        noise: Location of the generalized extreme value distribution of the amplitude without response, V.
        noise_scale: Scale of that distribution, V.
        noise_shape: Shape of that distribution; positive for a long upper tail.
    """

    threshold: float
    range_decades: float = 4.53
    half: float = 10.0**3.6466
    steepness: float = 10.0**0.4264
    input_spread: float = 10.0**0.6883
    output_spread: float = 10.0**-0.9645
    noise: float = 10.0**-5.0818
    noise_scale: float = 1.55e-6
    noise_shape: float = 0.14

    def sample(self, intensity: float, rng: np.random.Generator) -> float:
        """Draw the peak-to-peak amplitude after one pulse, V.

        Args:
            intensity: Effective intensity, percent of the maximum stimulator output.
            rng: Source of the variability.
        """
        x = intensity - self.onset + rng.normal(0.0, self.input_spread)
        noise = float(self._noise_at(rng.uniform()))
        return max(noise, 0.0) + self._response(x, rng.normal(0.0, self.output_spread))

    def probability(self, intensity: float) -> float:
        """Return the probability of a response of at least `RESPONSE` to one pulse.

        Args:
            intensity: Effective intensity, percent of the maximum stimulator output.
        """
        return self._response_fraction(intensity - self.onset)

    def amplitude(self, intensity: float) -> float:
        """Return the peak-to-peak amplitude without variability, V.

        Args:
            intensity: Effective intensity, percent of the maximum stimulator output.
        """
        return self.noise + self._response(intensity - self.onset, 0.0)

    def _response(self, x: float, output: float) -> float:
        """Return the amplitude without the noise of the measurement, V.

        Args:
            x: Intensity above the onset, percent of the maximum stimulator output.
            output: Deviation of the amplitude, decades.
        """
        share = 0.0 if x <= 0.0 else 1.0 / (1.0 + self.half * x**-self.steepness)
        return float(LOWEST * 10.0 ** (self.range_decades * share + output))

    def _noise_at(self, quantile: npt.ArrayLike) -> Floats:
        """Return the noise of the measurement at quantiles of its distribution, V, in their shape."""
        scaled: Floats = np.expm1(-self.noise_shape * np.log(-np.log(quantile))) / self.noise_shape
        return self.noise + self.noise_scale * scaled

    @cached_property
    def onset(self) -> float:
        """Intensity at which the sigmoid starts, percent of the maximum stimulator output."""
        return self.threshold - self._threshold_above_onset

    @cached_property
    def _threshold_above_onset(self) -> float:
        """Intensity above the onset at which half of the pulses give a response, percent; found by bisection."""
        low, high = 0.0, 1e3
        while high - low > 1e-9:
            middle = 0.5 * (low + high)
            low, high = (middle, high) if self._response_fraction(middle) < 0.5 else (low, middle)
        return low

    def _response_fraction(self, x: float) -> float:
        """Return the fraction of pulses with a response at an intensity `x` above the onset, percent."""
        needed, weights = self._needed_intensities
        deviations = (x - needed) / (math.sqrt(2.0) * self.input_spread)
        return float(weights @ [0.5 * math.erfc(-deviation) for deviation in deviations])

    @cached_property
    def _needed_intensities(self) -> tuple[Floats, Floats]:
        """Intensities above the onset that a response needs, percent, (k,), and their weights, (k,)."""
        outputs, weights = OUTPUT_NODES
        noises = self._noise_at(NOISE_QUANTILES)
        decades = np.log10(np.maximum(RESPONSE - noises, LOWEST) / LOWEST)
        share = (decades[:, None] - self.output_spread * outputs) / self.range_decades
        within = np.clip(share, 1e-12, 1.0 - 1e-12)
        needed = (self.half * within / (1.0 - within)) ** (1.0 / self.steepness)
        return needed.ravel(), np.tile(weights / weights.sum() / len(noises), len(noises))


def draw(rng: np.random.Generator) -> Recruitment:
    """Draw a subject of the published population whose threshold can be measured."""
    while True:
        half, steepness, onset = 10.0 ** rng.multivariate_normal(CURVE_MEAN, CURVE_COVARIANCE)
        subject = Recruitment(
            threshold=0.0,  # follows from the onset
            range_decades=rng.normal(4.532264929, np.sqrt(0.126168431583)),
            half=float(half),
            steepness=float(steepness),
            input_spread=10.0 ** rng.normal(0.688273244, 0.023671071119),
            output_spread=10.0 ** rng.normal(-0.96453346025, 0.022758778017),
            noise=10.0 ** rng.normal(-5.081764824125, np.sqrt(0.003570541967)),
            noise_scale=1.55e-6 * 1.5 ** rng.normal(),
            noise_shape=0.14 * 2.0 ** rng.normal(),
        )
        subject = replace(subject, threshold=float(onset - subject.onset))
        if _measurable(subject):
            return subject


def _measurable(subject: Recruitment) -> bool:
    """Return true for a plausible subject: silent at 20 %, 1 to 30 mV at 120 %, a threshold in `THRESHOLDS`.

    The first two are the conditions of Goetz et al. 2019.
    """
    low, high = THRESHOLDS
    expected = subject.amplitude(20.0) < 30e-6 and 1e-3 < subject.amplitude(120.0) < 30e-3
    return expected and low < subject.threshold < high
