"""The estimated force on the flange."""

import numpy as np
import pytest

from pcmrs_sim.force import ForceSensor
from pcmrs_sim.settings import ArmSettings


def test_the_estimate_has_the_stated_noise_and_no_bias() -> None:
    settings, axis = ArmSettings(), np.array([0.0, 0.0, -1.0])
    sensor = ForceSensor(axis, settings, 1e-3, np.random.default_rng(2))
    seen = []
    for _ in range(20_000):
        sensor.update(3.0)
        seen.append(sensor.flange_force)
    values = np.array(seen[1000:])
    share = 1 - np.exp(-2 * np.pi * settings.force_filter_hz * 1e-3)
    assert values.mean(axis=0) == pytest.approx([0.0, 0.0, -3.0], abs=0.01)
    assert values.std(axis=0) == pytest.approx(settings.force_noise * np.sqrt(share / (2 - share)), rel=0.1)
