"""How fast a simulated cell may run on a machine that does other things, too."""

from __future__ import annotations

import pytest

from pcmrs_lab.experiment.speed import reachable_speed


@pytest.mark.parametrize(
    ("wanted", "share", "rate"),
    [(5.0, 0.9, 5.0), (20.0, 0.5, 20.0), (5.0, 0.2, 2.0), (5.0, 0.01, 1.0), (1.0, 0.01, 1.0)],
)
def test_busy_machine_lowers_the_rate_at_most_to_real_time(wanted: float, share: float, rate: float) -> None:
    """The reason is reported."""
    speed = reachable_speed(wanted, share)
    assert speed.rate == rate
    assert ("The machine is busy" in speed.why) == (rate != wanted)
