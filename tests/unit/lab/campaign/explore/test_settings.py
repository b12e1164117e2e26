"""An explored cell has the limits of a delivered one, slower streams, and the seed of its session."""

from __future__ import annotations

from pathlib import Path

import pytest

from pcmrs.errors import ConfigurationError
from pcmrs.settings import Settings, read_settings
from pcmrs_lab.campaign.explore import settings as explored
from pcmrs_lab.campaign.explore.settings import DEADMAN, REAL_RATES, SLOWER, settings_of, workflow_of


@pytest.fixture(scope="module")
def kinematic() -> Settings:
    return settings_of("ratms", "kinematic", 7)


def test_each_session_has_its_seed(kinematic: Settings) -> None:
    other = settings_of("ratms", "kinematic", 8)
    assert (kinematic.sim["seed"], other.sim["seed"]) == (7, 8)
    assert {**kinematic.sim, "seed": 0} == {**other.sim, "seed": 0}


def test_streams_are_slow_unless_the_arm_is_heavy(kinematic: Settings) -> None:
    heavy = settings_of("ratms", "mujoco", 7)
    assert (kinematic.robot.deadman, heavy.robot.deadman) == (DEADMAN, DEADMAN)
    assert kinematic.sim["tracker"]["rate_hz"] == 6.25
    assert "rate_hz" not in heavy.sim.get("tracker", {})
    assert (kinematic.sim["arm"]["physics"], heavy.sim["arm"]["physics"]) == ("kinematic", "mujoco")
    assert set(REAL_RATES) < set(SLOWER)


def test_limits_of_motions_are_those_of_a_delivered_cell(kinematic: Settings) -> None:
    delivered = read_settings(overrides=("workflow=ratms",))
    assert kinematic.procedure.motion == delivered.procedure.motion
    assert kinematic.procedure.placement.tolerance_mm == delivered.procedure.placement.tolerance_mm


def test_an_unknown_workflow_is_refused() -> None:
    with pytest.raises(ConfigurationError):
        workflow_of("no_such_workflow")


def test_a_workflow_is_opened_once(monkeypatch: pytest.MonkeyPatch) -> None:
    opened: list[str] = []

    def open_workflow(name: str) -> Path:
        opened.append(name)
        return Path(name)

    monkeypatch.setattr(explored, "open_workflow", open_workflow)
    workflow_of.cache_clear()
    assert workflow_of("one") is workflow_of("one")
    assert opened == ["one"]
    workflow_of.cache_clear()
