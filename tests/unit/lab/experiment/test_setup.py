"""Settings of an experiment: speed, drivers and the user's own, in an order in which the user's count."""

from __future__ import annotations

import pytest

from pcmrs.settings import read_settings
from pcmrs.testing.plan import example_plan, read_plan
from pcmrs_lab.experiment.setup import Drivers, ExperimentSetup, at_rate


def setup(drivers: Drivers = "builtin", rate: float = 5.0, overrides: tuple[str, ...] = ()) -> ExperimentSetup:
    return ExperimentSetup(read_plan(example_plan("ratms")), "ratms", 1, rate, drivers, overrides, lambda *_: None)


def test_the_users_settings_count_in_place_of_the_experiments() -> None:
    settings = setup(rate=5.0, overrides=("cell.rate=2", "robot.deadman=0.2")).settings()
    read = read_settings(overrides=settings)
    assert (read.cell.rate, read.robot.deadman) == (2.0, 0.2)


@pytest.mark.parametrize(("drivers", "robot", "tracker"), [("builtin", "sim", "sim"), ("virtual", "kst", "ndi")])
def test_virtual_devices_are_reached_by_the_drivers_of_real_ones(drivers: Drivers, robot: str, tracker: str) -> None:
    read = read_settings(overrides=setup(drivers, rate=1.0).settings())
    assert (read.robot.driver, read.tracker.driver) == (robot, tracker)


def test_a_rate_is_written_without_loss() -> None:
    assert at_rate(2.5)[0] == "cell.rate=2.5"
    assert at_rate(5.0)[0] == "cell.rate=5"
