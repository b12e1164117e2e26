"""A trajectory as samples."""

import numpy as np

from pcmrs.messages import JointTrajectory
from tests.unit.devices.spring import HOME, STEPS, Spring, follower, run


@STEPS
def test_a_trajectory_ends_where_and_when_it_should(step: float) -> None:
    time = np.linspace(0.0, 1.0, 101)
    way = (10 * time**3 - 15 * time**4 + 6 * time**5)[:, None] * 0.3
    arm = follower(step)
    arm.follow(JointTrajectory(period=0.01, positions=(HOME + way * np.ones(7)).tolist()))
    samples = run(arm, Spring(1.0), step, 5.0)
    assert len(samples) == round(1.0 / step)
    assert np.allclose(samples[-1, 0], HOME + 0.3)
    assert np.allclose(samples[-1, 1:], 0.0)
    assert np.allclose(np.diff(samples[:, 0], axis=0) / step, samples[1:, 1], atol=3.0 * step)
