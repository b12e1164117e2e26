"""How the head of the following experiment moves: as said, and as the simulation takes it."""

from __future__ import annotations

import numpy as np
import pytest

from pcmrs_lab.experiment.head_motions import scenarios
from pcmrs_sim.motion import check_motion, head_offset

DURATION = 20.0
MOTIONS = {each.name: each for each in scenarios(DURATION, seed=1)}


@pytest.mark.parametrize("name", MOTIONS)
def test_the_simulation_takes_every_motion(name: str) -> None:
    check_motion(MOTIONS[name].motion)


def test_the_head_drifts_as_far_as_in_half_an_hour() -> None:
    assert np.linalg.norm(head_offset(MOTIONS["drift"].motion, DURATION)) == pytest.approx(0.060)
    assert "90 times as fast" in MOTIONS["drift"].text


@pytest.mark.parametrize(("name", "farthest"), [("still", 0.0), ("steps", 0.005), ("bursts", 0.0344)])
def test_the_head_goes_and_comes_back(name: str, farthest: float) -> None:
    way = np.array([head_offset(MOTIONS[name].motion, time) for time in np.arange(0.0, DURATION, 0.05)])
    assert np.linalg.norm(way, axis=1).max() == pytest.approx(farthest)
    assert np.linalg.norm(way[-1]) == pytest.approx(0.0, abs=1e-9)


def test_breathing_begins_without_a_jump_and_its_seed_fixes_it() -> None:
    one, same, other = (
        next(each.motion for each in scenarios(DURATION, seed) if each.name == "breathing") for seed in (1, 1, 2)
    )
    assert one == same != other
    assert np.linalg.norm(head_offset(one, 0.0)) == 0.0
    assert max(np.linalg.norm(head_offset(one, time)) for time in np.arange(0.0, 4.0, 0.1)) <= 2 * 0.002


@pytest.mark.parametrize("duration", [10.0, 13.0, 60.0])
def test_all_steps_and_bursts_are_within_the_run(duration: float) -> None:
    motions = {each.name: each.motion for each in scenarios(duration, 1)}
    assert max(step.time for step in motions["steps"].steps) < duration - 1.0
    assert max(burst.time + burst.duration for burst in motions["bursts"].bursts) < duration - 1.0
