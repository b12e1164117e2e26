"""How fast a simulated cell may run on a machine that does other things, too."""

from __future__ import annotations

import re

import pytest

from pcmrs_lab.experiment import speed
from pcmrs_lab.experiment.speed import processor_share, reachable_speed


@pytest.mark.parametrize(
    ("wanted", "share", "rate"),
    [(5.0, 0.9, 5.0), (20.0, 0.75, 20.0), (5.0, 0.3, 2.0), (5.0, 0.01, 1.0), (1.0, 0.01, 1.0)],
)
def test_busy_machine_lowers_the_rate_at_most_to_real_time(wanted: float, share: float, rate: float) -> None:
    """The reason is reported."""
    found = reachable_speed(wanted, share)
    assert found.rate == rate
    assert ("The machine is busy" in found.why) == (rate != wanted)


@pytest.mark.parametrize("wanted", [1.25, 2.26, 0.5, 3.14159])
def test_an_idle_machine_keeps_any_rate_as_it_was_given(wanted: float) -> None:
    assert reachable_speed(wanted, 0.9) == (wanted, "")


@pytest.mark.parametrize("wanted", [1.26, 2.26, 4.99])
def test_a_busy_machine_never_runs_faster_than_wanted(wanted: float) -> None:
    assert 1.0 <= reachable_speed(wanted, 0.749).rate <= wanted


def test_a_lower_rate_names_the_load_and_both_rates() -> None:
    assert re.fullmatch(
        r"The machine is busy \(.+\): .* 2 times as fast as real time, not 5 times\.", reachable_speed(5.0, 0.3).why
    )


def test_the_measured_share_is_that_of_a_thread(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(speed, "TRIAL", 0.01)
    assert 0.0 < processor_share() < 1.1
