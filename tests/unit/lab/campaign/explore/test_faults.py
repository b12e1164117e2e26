"""Faults of a session are those of the simulation and of the catalogue, with arguments that it takes."""

from __future__ import annotations

import random

import pytest

from pcmrs_lab.campaign.catalogue import catalogue
from pcmrs_lab.campaign.explore.faults import FAULTS, HOST, NETWORK, SCENE
from pcmrs_sim.faults import FAULTS as SIMULATED

DRAWS = 50


def test_every_fault_of_the_simulated_cell_is_there() -> None:
    """A fault that is added to the simulation is explored, or this fails."""
    assert SCENE.keys() == SIMULATED.keys()
    assert len(FAULTS) == len(SCENE) + len(NETWORK) + len(HOST), "each name is that of one fault"


def test_each_fault_is_one_of_the_catalogue() -> None:
    assert {row for fault in FAULTS.values() for row in fault.rows} <= set(catalogue())
    assert all(fault.rows for fault in FAULTS.values())


@pytest.mark.parametrize("name", SCENE)
def test_the_simulation_takes_what_begins_and_ends_it(name: str) -> None:
    draw, fault = random.Random(1), SCENE[name]
    known = set(SIMULATED[name].arguments)
    for _ in range(DRAWS):
        begin = fault.draw(draw)
        assert set(begin) <= known
        assert set(fault.end or {}) <= known
        assert fault.end is None or set(fault.end) <= set(begin), "what is ended was begun"


@pytest.mark.parametrize("name", FAULTS)
def test_the_end_of_a_fault_differs_from_its_beginning(name: str) -> None:
    fault = FAULTS[name]
    begun = [fault.draw(random.Random(seed)) for seed in range(DRAWS)]
    for key, value in (fault.end or {}).items():
        assert all(each.get(key) != value for each in begun)


@pytest.mark.parametrize("name", FAULTS)
def test_a_fault_lasts_and_is_drawn(name: str) -> None:
    assert FAULTS[name].lasts > 0.2
    assert FAULTS[name].weight > 0.0


def test_a_partition_and_a_swap_are_between_two() -> None:
    for seed in range(DRAWS):
        cut = FAULTS["partition"].draw(random.Random(seed))
        assert cut["from"] != cut["to"]
        swap = FAULTS["tool_swap"].draw(random.Random(seed))
        assert swap["first"] != swap["second"]
