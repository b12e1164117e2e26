"""Disturbances of the simulated network."""

import random

import pytest

from pcmrs_sim.deterministic.network_conditions import NetworkConditions

PAIRS = [("one", "other"), ("other", "one"), ("one", "third")]


def lost(conditions: NetworkConditions) -> list[bool]:
    return [conditions.lost(source, target, random.Random(1)) for source, target in PAIRS]


@pytest.mark.parametrize(("both", "expected"), [(True, [True, True, False]), (False, [True, False, False])])
def test_a_partition_loses_everything_in_its_directions(both: bool, expected: list[bool]) -> None:
    conditions = NetworkConditions()
    conditions.partition("one", "other", both=both)
    assert lost(conditions) == expected


def test_about_the_stated_fraction_is_lost() -> None:
    conditions, draw = NetworkConditions(loss=0.3), random.Random(1)
    count = sum(conditions.lost("one", "other", draw) for _ in range(10_000))
    assert count == pytest.approx(3000, abs=150)


@pytest.mark.parametrize("name", ["delay", "loss", "duplicates", "reordering"])
def test_healing_ends_every_disturbance(name: str) -> None:
    conditions = NetworkConditions()
    assert conditions.undisturbed
    setattr(conditions, name, 0.5)
    conditions.partition("one", "third")
    assert not conditions.undisturbed
    conditions.heal()
    assert conditions.undisturbed
    assert lost(conditions) == [False] * 3


def test_an_undisturbed_network_draws_no_random_numbers() -> None:
    """A disturbance must not change what the same seed gives before it."""
    draw = random.Random(1)
    before = draw.getstate()
    assert not NetworkConditions().lost("one", "other", draw)
    assert draw.getstate() == before
