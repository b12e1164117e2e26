"""Setup of a session: its settings, the place where the search begins, and what it refuses."""

from __future__ import annotations

from typing import Any

import msgspec
import pytest

from pcmrs.errors import ConfigurationError
from pcmrs.formats.mesh import Mesh
from pcmrs.testing.plan import example_plan, read_plan
from pcmrs.workflows.settings import ProcedureSettings
from pcmrs_lab.experiment.session.setup import SessionSetup
from tests.support.session_records import mesh

PLAN = read_plan(example_plan("ratms"))


@pytest.fixture(autouse=True)
def surface_is_read_once(monkeypatch: pytest.MonkeyPatch) -> None:
    def read(procedure: ProcedureSettings) -> Mesh | None:
        return mesh() if procedure.body.surface else None

    monkeypatch.setattr("pcmrs_lab.experiment.session.setup.read_surface", read)


def setup(**given: Any) -> SessionSetup:
    return SessionSetup(PLAN, **given)


@pytest.mark.parametrize("budget", [1, 5, 500])
def test_every_budget_can_be_kept(budget: int) -> None:
    """Fewer pulses than a search takes at least are allowed, too: they lower that number."""
    hotspot = setup(budget=budget).configuration.procedure.stimulation.hotspot
    assert hotspot.max_pulses == budget >= hotspot.min_pulses


def test_own_settings_and_those_of_the_user_are_in_force() -> None:
    chosen = setup(seed=4, overrides=("procedure.placement.frames=50", "procedure.stimulation.intervals.least=7.5"))
    assert chosen.configuration.sim["seed"] == 4
    assert chosen.configuration.procedure.placement.frames == 50
    assert chosen.interval == 7.5
    assert chosen.settings()[-2:] == list(chosen.overrides), "the user's come last, so that they count"


def test_only_a_fast_cell_tolerates_late_poses() -> None:
    fast, real = setup(rate=5.0).configuration.procedure, setup(rate=1.0).configuration.procedure
    assert fast.alignment.off_time == pytest.approx(0.5)
    assert fast.stimulation.pose_age > real.stimulation.pose_age
    assert not [each for each in setup(rate=1.0).settings() if "pose_age" in each or "off_time" in each]


def test_a_grid_is_expected_to_be_measured_completely() -> None:
    grid = setup(method="grid", overrides=("procedure.stimulation.hotspot.rings=2",))
    assert grid.expected_pulses == 2 * 15 + 19  # 1 + 6 + 12 places
    assert setup(budget=40).expected_pulses == 2 * 15 + 40


def test_the_search_begins_on_the_right_side_of_the_head() -> None:
    centre, mesh = setup().centre(), setup().mesh
    assert isinstance(mesh, Mesh)
    assert 0.04 < centre.position[0] < 0.07
    assert abs(centre.position[1]) < 0.03


@pytest.mark.parametrize(
    ("plan", "overrides"),
    [(msgspec.structs.replace(PLAN, poses=()), ()), (PLAN, ('procedure.body.surface=""',))],
)
def test_a_session_without_vertex_or_surface_is_refused(plan: Any, overrides: tuple[str, ...]) -> None:
    with pytest.raises(ConfigurationError, match="needs a surface of the head, and a plan"):
        SessionSetup(plan, overrides=overrides)


def test_a_wrong_setting_is_refused_before_anything_starts() -> None:
    with pytest.raises(ConfigurationError, match="wheels"):
        setup(overrides=("robot.wheels=4",))
