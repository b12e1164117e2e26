"""Values that a blueprint derives from its declarations: motions, parents, releases, and use of the robot."""

from __future__ import annotations

import msgspec

from pcmrs.fsm import load_blueprint, parse_blueprint
from tests.unit.fsm.exposure_workflows import BIOPSY, BY_HAND, SHIPPED, designed
from tests.unit.fsm.files.pump_workflow import PUMP
from tests.unit.fsm.rules.small_workflow import SMALL


def test_moves_alone_is_an_approach_and_is_barred_if_latched() -> None:
    blueprint = parse_blueprint((PUMP % 'moves = true, on_failure = "on", on_unknown = "on"').encode())
    start = blueprint.branches["pump"].operations["start"]
    assert (start.moves, start.motion, start.blocked_when_latched) == (True, "approach", True)


def test_the_sound_blueprint_loads() -> None:
    blueprint = parse_blueprint(SMALL.encode())
    assert list(blueprint.branches) == ["top", "sub", "side"]
    assert blueprint.revokers == {"top"}
    assert list(blueprint.children["top"]) == ["sub"]
    assert len(blueprint.hash) == 64


def test_a_workflow_uses_the_robot_where_it_connects_or_moves_it() -> None:
    assert not designed(BY_HAND).uses_robot
    assert designed(BIOPSY.read_bytes()).uses_robot
    ratms = load_blueprint(SHIPPED / "ratms.toml")
    assert msgspec.structs.replace(ratms, branches={"placement": ratms.branches["placement"]}).uses_robot
