"""Tours of the engine: complete on random workflows, and a wrong engine is found out."""

from __future__ import annotations

import pytest
from hypothesis import given

from pcmrs.authoring.trial.engine_tour import tour_engine
from pcmrs.authoring.trial.tour import plan_tour
from pcmrs.fsm import Blueprint
from tests.support.altered import with_operation
from tests.support.trials import examples
from tests.unit.authoring.trial.ratms_tour import RATMS, check_connected, ratms_tour
from tests.unit.fsm.random_blueprints import blueprints


@given(blueprints())
@examples(40)
def test_random_workflows_are_toured_completely(blueprint: Blueprint) -> None:
    tour = plan_tour(blueprint)
    check_connected(blueprint, tour)
    done = list(tour_engine(blueprint, tour))
    assert [deviation for _, deviation in done if deviation is not None] == []
    assert {move for move, _ in done} == set(tour.wanted)


@pytest.mark.parametrize(
    ("branch", "operation", "fields"),
    [
        ("placement", "confirm", {"from_": ["standoff", "retracted"]}),
        ("placement", "home", {"from_": ["standoff", "placed", "following"]}),
        ("placement", "approach", {"on_failure": None}),
        ("placement", "approach", {"on_unknown": "held"}),
        ("registration", "register", {"to": "110"}),
        ("registration", "reinit", {"requires": {}}),
        ("registration", "use_previous", {"sets": {}}),
        ("robot", "link_lost", {"to": "1"}),
        ("toolplan", "reinit", {"refusal": "another_code"}),
    ],
)
def test_an_engine_that_runs_something_else_deviates(branch: str, operation: str, fields: dict[str, object]) -> None:
    done = list(tour_engine(with_operation(RATMS, branch, operation, **fields), ratms_tour()))
    assert any(deviation is not None and f"{branch}.{operation}" in str(deviation) for _, deviation in done)
