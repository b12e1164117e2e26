"""The verification as a whole, on random workflows."""

from __future__ import annotations

import msgspec
import pytest
from hypothesis import given

from pcmrs.fsm._codes import VERIFICATION
from pcmrs.fsm.behaviour import branch_states
from pcmrs.fsm.blueprint import Blueprint, Condition, PropertySpec
from pcmrs.fsm.rules import check_rules
from pcmrs.fsm.verify import verify
from tests.support.shipped import NAMES, shipped_blueprint
from tests.support.trials import examples
from tests.unit.fsm.command_trace import follow_commands
from tests.unit.fsm.large_blueprints import entangled, free, promising
from tests.unit.fsm.random_blueprints import blueprints
from tests.unit.fsm.ratms_mutants import mutants
from tests.unit.fsm.verify.finding_oracle import cut_short
from tests.unit.fsm.verify.joint_state_oracle import levels


@examples(40)
@given(blueprints())
def test_workflows_obey_static_rules_and_finding_codes_are_known(blueprint: Blueprint) -> None:
    assert list(check_rules(blueprint)) == []
    assert {finding.code for finding in verify(blueprint).findings} <= set(VERIFICATION)


@examples(40)
@given(blueprints())
def test_children_fit_their_parents_in_every_joint_state(blueprint: Blueprint) -> None:
    for states in (branch_states(blueprint, joint) for joint in levels(blueprint)):
        for name, branch in blueprint.branches.items():
            parent = branch.parent
            assert parent is None or states[parent.branch] in parent.compatible[states[name]]


@examples(40)
@given(blueprints())
def test_fault_that_cuts_the_search_short_is_the_only_finding(blueprint: Blueprint) -> None:
    local = {"endless_cascade", "no_outcome", "ambiguous_revocation", "order_dependent"}
    if cut_short(blueprint):
        promise = PropertySpec(id="promise", never=Condition())
        found = verify(msgspec.structs.replace(blueprint, properties=[promise])).findings
        assert {finding.code for finding in found} <= local
        assert found


@pytest.mark.parametrize("blueprint", [free(20, 2), free(10, 4), entangled(10, 4)], ids=["20x2", "10x4", "entangled"])
@pytest.mark.nightly
def test_a_million_joint_states_are_searched(blueprint: Blueprint) -> None:
    calls: list[tuple[int, int]] = []
    found = verify(blueprint, progress=lambda looked_at, known: calls.append((looked_at, known)))
    assert list(check_rules(blueprint)) == []
    assert found.findings == []
    assert found.joint_states == 2**20
    assert calls == sorted(calls)
    assert calls[-1] == (2**20, 2**20)


@pytest.mark.nightly
def test_million_joint_states_are_twice_as_many_while_one_runs() -> None:
    """Each of four properties has its own, and all of them are part of the progress."""
    (alone,) = promising(20).properties
    four = [msgspec.structs.replace(alone, id=f"alone_{n}", when=Condition(running=[f"b{n}.on"])) for n in range(4)]
    blueprint = msgspec.structs.replace(promising(20), properties=four)
    calls: list[tuple[int, int]] = []
    assert verify(blueprint, progress=lambda looked_at, known: calls.append((looked_at, known))).findings == []
    assert calls == sorted(calls)
    assert calls[-1][0] == calls[-1][1] > 16 * 2**20


@pytest.mark.parametrize("name", NAMES)
def test_shipped_workflows_are_sound(name: str) -> None:
    found = verify(shipped_blueprint(name))
    assert found.findings == []
    assert name != "ratms" or found.joint_states == 40


UNSOUND = {name for name in mutants() if "revo" in name} | {"placement.approach without requires"}
"""Mutants that break a promise."""


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=() if name in UNSOUND else pytest.mark.nightly) for name in mutants()]
)
def test_every_command_sequence_of_a_mutant_can_be_followed(name: str) -> None:
    mutant = mutants()[name]()
    found = verify(mutant).findings
    assert bool(found) == (name in UNSOUND)
    for finding in found:
        if finding.code not in ("unreachable_state", "vacuous_property"):  # what never holds, no commands lead to
            assert finding.commands is not None
            follow_commands(mutant, finding.commands)
