"""Values that a blueprint derives from its declarations: motions, parents, releases, and use of the robot."""

from __future__ import annotations

import msgspec
import pytest

from pcmrs.fsm import parse_blueprint
from pcmrs.fsm.blueprint import START_OUTCOME, Blueprint, OperationSpec, OutcomeSpec
from pcmrs.messages.identity import COMMANDING
from tests.support.shipped import shipped_blueprint
from tests.unit.fsm.exposure_workflows import BIOPSY, BY_HAND, designed
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
    ratms = shipped_blueprint("ratms")
    assert msgspec.structs.replace(ratms, branches={"placement": ratms.branches["placement"]}).uses_robot


@pytest.mark.parametrize("more", ["event = true", "iio = true", "affects_patient = true"])
def test_stop_is_released_by_what_users_may_ask_for_meanwhile(more: str) -> None:
    plain = {"from": ["*"], "to": "on", "unlatches": True}
    other = plain | {more.partition(" ")[0]: True}
    branch = {"states": {"on": ""}, "operations": {"acknowledge": plain, "other": other}}
    blueprint = msgspec.convert({"id": "x", "version": "1", "branches": {"pump": branch}}, Blueprint)
    assert blueprint.unlatching == ["pump.acknowledge"]


def test_targets_are_apart_by_how_an_operation_ends() -> None:
    spec = OperationSpec(
        from_=["a", "b"],
        outcomes={"well": OutcomeSpec(to={"a": "c", "b": "d"}), "badly": OutcomeSpec(to="a")},
        on_failure="e",
    )
    assert spec.declared_targets() == {"a", "c", "d"}
    assert spec.unconfirmed_targets() == {"e"}
    assert spec.targets() == {"a", "c", "d", "e"}
    assert OperationSpec(from_=["a"], to="b").endings.keys() == {START_OUTCOME}


def test_an_operation_that_a_version_lacks_is_not_found() -> None:
    blueprint = parse_blueprint(SMALL.encode())
    assert blueprint.find("side", "move") is blueprint.branches["side"].operations["move"]
    assert blueprint.find("side", "fly") is None
    assert blueprint.find("roof", "move") is None


def test_roles_without_any_named_are_all_that_may_command() -> None:
    assert OperationSpec(from_=["a"], to="b").allowed_roles == list(COMMANDING)
    assert OperationSpec(from_=["a"], to="b", roles=["operator"]).allowed_roles == ["operator"]
