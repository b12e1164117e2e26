"""The table `sim` of the configuration: what is refused names its key and its value."""

from typing import Any

import numpy as np
import pytest

from pcmrs.errors import ConfigurationError
from pcmrs_sim.settings import ConfiguredPose, DigitizationSettings, SimSettings, read_settings


def test_an_absent_table_is_all_defaults_and_others_are_ignored() -> None:
    assert read_settings({}) == read_settings({"robot": {"model": "ur5"}}) == SimSettings()


def test_what_is_set_is_taken_and_the_rest_stays() -> None:
    read = read_settings({"sim": {"seed": 7, "tracker": {"rate_hz": 20}}})
    assert (read.seed, read.tracker.rate_hz) == (7, 20.0)
    assert read.tracker.latency == SimSettings().tracker.latency


@pytest.mark.parametrize(
    ("table", "text"),
    [
        ({"seeed": 3}, "seeed"),
        ({"seed": 1.5}, r"\$\.seed"),
        ({"arm": {"inertia_error": 1.0}}, r"\$\.arm\.inertia_error"),
        ({"arm": {"stiffness": [100.0, 0.0]}}, r"\$\.arm\.stiffness"),
        ({"tracker": {"rate_hz": 0.0}}, r"\$\.tracker\.rate_hz"),
        ({"muscle": {"rate_hz": 50}}, r"\$\.muscle\.rate_hz"),
        ({"contact": {"damping": -1.0}}, r"\$\.contact\.damping"),
        ({"geometry": {"flange_from_tool_tip": {"quat_wxyz": [1.0, 1.0, 0.0, 0.0]}}}, r"\$\.geometry\.flange_from"),
        ({"geometry": {"flange_from_tool_tip": {"position": [0.0, 0.0]}}}, r"\$\.geometry\.flange_from.*\.position"),
    ],
)
def test_a_wrong_value_is_refused_with_its_key(table: dict[str, Any], text: str) -> None:
    with pytest.raises(ConfigurationError, match=text):
        read_settings({"sim": table})


def test_a_configured_pose_is_the_transform_of_its_numbers() -> None:
    pose = ConfiguredPose((0.1, 0.2, 0.3), (0.5, 0.5, 0.5, 0.5)).transform
    assert pose @ np.array([1.0, 0.0, 0.0]) == pytest.approx([0.1, 1.2, 0.3])


def test_the_deviations_of_a_person_combine_to_those_on_a_head() -> None:
    person = DigitizationSettings()
    assert np.hypot(person.planning_bias_mm, person.noise_mm) == pytest.approx(1.86, abs=0.005)
    assert person.rest_time > SimSettings().tracker.latency
