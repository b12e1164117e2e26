"""How big a motor evoked potential is: recruitment by the stimulus, with variability before and after it.

The model and its population are those of Goetz, Alavi, Deng, Peterchev, Statistical Model of Motor-Evoked Potentials,
IEEE Trans. Neural Syst. Rehabil. Eng. 27 (2019) 1539, on the two sources of variability of Goetz, Luber, Lisanby,
Peterchev, Brain Stimul. 7 (2014) 541: a sigmoid between the intensity and the logarithm of the amplitude, with noise
added to both, over the noise of the measurement; the parameters are those that the authors publish with their code. It
is not the model that thresholds are estimated with.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import numpy.typing as npt

from pcmrs.spatial import Floats

RESPONSE = 50e-6
"""Least peak-to-peak amplitude of a response, V: Rossini et al., Clin. Neurophysiol. 126 (2015) 1071."""

LOWEST = 1e-7
"""What the sigmoid of the amplitude starts from, V."""

THRESHOLDS = (30.0, 100.0)
"""That can be measured, percent of the maximum stimulator output: Wang, Peterchev, Goetz, J. Neural Eng. 20 (2023)."""

CURVE_MEAN = np.array([3.646550162125, 0.426390035500, 1.666487134750])
CURVE_COVARIANCE = np.array(
    [
        [7.202738820058, 0.569742608764, -0.197461987887],
        [0.569742608764, 0.047425817251, -0.015113039713],
        [-0.197461987887, -0.015113039713, 0.007107112788],
    ]
)
"""Decimal logarithms of half, steepness and onset in the population: Goetz et al. 2019."""

OUTPUT_NODES = np.polynomial.hermite_e.hermegauss(15)
NOISE_QUANTILES = (np.arange(15) + 0.5) / 15


@dataclass(frozen=True)
class Recruitment:
    """One subject; the defaults are the middle of the population.

    Attributes:
        threshold: Intensity at which half of the pulses give a response of `RESPONSE`, percent of the maximum
            stimulator output.
        range_decades: Between the amplitudes without and with all of the muscle, decades.
        half: Of the sigmoid ``1 / (1 + half / x**steepness)`` of the intensity x above the onset, in percent,
        steepness: and its exponent.
        input_spread: Variability of excitation, standard deviation, percent of the maximum stimulator output.
        output_spread: Variability of what follows, standard deviation, decades of the amplitude.
        noise: Peak-to-peak amplitude of the measurement without response, V: where its distribution, a generalized
            extreme value distribution, is located,
        noise_scale: its scale, V,
        noise_shape: and its shape, positive: a long upper tail.
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
        """Peak-to-peak amplitude after one pulse, V.

        Args:
            intensity: Percent of the maximum stimulator output.
            rng: Source of the variability.
        """
        x = intensity - self._onset + rng.normal(0.0, self.input_spread)
        noise = float(self._noise_at(rng.uniform()))
        return max(noise, 0.0) + self._response(x, rng.normal(0.0, self.output_spread))

    def probability(self, intensity: float) -> float:
        """Of a response of at least `RESPONSE` to one pulse; the intensity in percent of the maximum output."""
        return self._share(intensity - self._onset)

    def _response(self, x: float, output: float) -> float:
        """Amplitude without the measurement's noise, V, of the intensity `x` above the onset, in percent."""
        share = 0.0 if x <= 0.0 else 1.0 / (1.0 + self.half * x**-self.steepness)
        return float(LOWEST * 10.0 ** (self.range_decades * share + output))

    def _noise_at(self, quantile: npt.ArrayLike) -> Floats:
        """The measurement's noise at quantiles of its distribution, V, of their shape."""
        scaled: Floats = np.expm1(-self.noise_shape * np.log(-np.log(quantile))) / self.noise_shape
        return self.noise + self.noise_scale * scaled

    @cached_property
    def _onset(self) -> float:
        """Where the sigmoid starts, percent of the maximum stimulator output."""
        return self.threshold - self._middle

    @cached_property
    def _middle(self) -> float:
        """Intensity above the onset at which half of the pulses give a response, percent."""
        low, high = 0.0, 1e3
        while high - low > 1e-9:
            middle = 0.5 * (low + high)
            low, high = (middle, high) if self._share(middle) < 0.5 else (low, middle)
        return low

    def _share(self, x: float) -> float:
        """Share of pulses with a response, of the intensity `x` above the onset, in percent."""
        needed, weights = self._needed
        deviations = (x - needed) / (math.sqrt(2.0) * self.input_spread)
        return float(weights @ [0.5 * math.erfc(-deviation) for deviation in deviations])

    @cached_property
    def _needed(self) -> tuple[Floats, Floats]:
        """What it takes above the onset to respond, percent, for a sample of the output's variability; its weights."""
        outputs, weights = OUTPUT_NODES
        noises = self._noise_at(NOISE_QUANTILES)
        decades = np.log10(np.maximum(RESPONSE - noises, LOWEST) / LOWEST)
        share = (decades[:, None] - self.output_spread * outputs) / self.range_decades
        within = np.clip(share, 1e-12, 1.0 - 1e-12)
        needed = (self.half * within / (1.0 - within)) ** (1.0 / self.steepness)
        return needed.ravel(), np.tile(weights / weights.sum() / len(noises), len(noises))


def draw(rng: np.random.Generator) -> Recruitment:
    """A subject of the published population whose threshold can be measured."""
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
        subject = replace(subject, threshold=float(onset - subject._onset))
        if _measurable(subject):
            return subject


def _measurable(subject: Recruitment) -> bool:
    """Silent at 20 %, a plausible muscle at 120 % as in Goetz et al. 2019, and a threshold within `THRESHOLDS`."""
    silent = subject.noise + subject._response(20.0 - subject._onset, 0.0)
    full = subject.noise + subject._response(120.0 - subject._onset, 0.0)
    low, high = THRESHOLDS
    return silent < 30e-6 and 1e-3 < full < 30e-3 and low < subject.threshold < high
