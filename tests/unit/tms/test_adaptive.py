"""The Gaussian process of the adaptive search."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import RBF, ConstantKernel

from pcmrs.tms._adaptive import NOISE_DECADES, SPREAD_DECADES, posterior
from pcmrs.tms.scalp import as_transform
from tests.support.trials import examples
from tests.unit.tms.searches import begun, run, subject_at


@given(st.integers(0, 2**32 - 1))
@examples(20)
def test_the_process_is_that_of_scikit_learn(seed: int) -> None:
    rng = np.random.default_rng(seed)
    inputs, candidates = rng.normal(size=(12, 4)), rng.normal(size=(9, 4))
    outputs = rng.normal(size=12)
    kernel = ConstantKernel(SPREAD_DECADES**2) * RBF(1.0)
    oracle = GaussianProcessRegressor(kernel, alpha=NOISE_DECADES**2, optimizer=None).fit(inputs, outputs)
    expected, spread = oracle.predict(candidates, return_cov=True)
    mean, covariance = posterior(candidates, inputs, outputs)
    assert np.allclose(mean, expected, atol=1e-9)
    assert np.allclose(covariance, spread, atol=1e-9)


def test_adaptive_search_ends_at_a_known_place_or_at_its_budget() -> None:
    subject = subject_at(0.005, 0.0, 0.1)
    loose = run(begun("adaptive", uncertainty_mm=6.0), subject)
    assert 20 <= len(loose.pulses) < 40
    assert loose.estimate.uncertainty <= 0.006
    assert len(run(begun("adaptive", uncertainty_mm=50.0), subject).pulses) == 20
    assert len(run(begun("adaptive", uncertainty_mm=0.1, max_pulses=25), subject).pulses) == 25


def test_the_expected_map_is_highest_near_the_hotspot() -> None:
    subject = subject_at(0.007, 0.0, 0.0)
    search = run(begun("grid"), subject)
    places = [as_transform(place) for place in search.places]
    best = places[int(np.argmax(search.expected_amplitudes(places)))]
    assert np.linalg.norm(best.translation - subject.image_from_hotspot.translation) < 0.007
