"""The engine and another implementation of state charts take the same path through any workflow."""

from __future__ import annotations

from random import Random

import pytest

from tests.support.shipped import NAMES, shipped
from tests.unit.authoring.exchange.scxml_peer import trace
from tests.unit.fsm.random_blueprints import random_blueprint


def walk(seeds: range) -> None:
    accepted = [trace(random_blueprint(Random(seed)), Random(seed), 25) for seed in seeds]
    assert sum(count > 3 for count in accepted) > len(seeds) // 2, "too few traces went anywhere"


def test_random_workflows() -> None:
    walk(range(100))


@pytest.mark.nightly
@pytest.mark.timeout(3600)
def test_many_random_workflows() -> None:
    walk(range(1_000, 11_000))


@pytest.mark.parametrize("seed", [0, 1, *(pytest.param(seed, marks=pytest.mark.nightly) for seed in range(2, 12))])
def test_ratms(seed: int) -> None:
    assert trace(shipped("ratms"), Random(seed), 400) > 40


@pytest.mark.parametrize("name", NAMES)
def test_shipped_workflows(name: str) -> None:
    assert trace(shipped(name), Random(name), 150) > 10
