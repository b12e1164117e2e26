"""Transitions of an exported chart: in every joint state they do what the closure of the command does."""

from __future__ import annotations

from hypothesis import given

from pcmrs.authoring.exchange._cubes import holds
from pcmrs.authoring.exchange.exporting._coupling import combinations, coupled
from pcmrs.authoring.exchange.exporting._events import changes_of, commands
from pcmrs.authoring.exchange.exporting._nesting import Nesting, nesting_of
from pcmrs.authoring.exchange.exporting._reactions import reactions
from pcmrs.fsm.blueprint import Blueprint
from tests.support.shipped import shipped_blueprint
from tests.support.trials import examples
from tests.unit.fsm.random_blueprints import blueprints


@examples(30)
@given(blueprints())
def test_reactions_move_what_the_command_moves(blueprint: Blueprint) -> None:
    """Without nesting, so that each branch is a region and each reaction enters its own states."""
    found = list(reactions(blueprint, Nesting(blueprint, frozenset())))
    for command in commands(blueprint):
        own = [each for each in found if each.event == command.event]
        for joint in combinations(blueprint, coupled(blueprint, command.branch, command.operation)):
            fired = [each for each in own if joint[each.branch] == each.source and holds(each.guard, joint)]
            change = changes_of(blueprint, joint, command.branch, command.operation).get(command.ending)
            after = dict(change.states) if change else joint
            moved = dict(pair for each in fired for pair in each.entered)
            assert moved == {name: state for name, state in after.items() if state != joint[name]}
            # A command that is accepted and keeps the state still has its transition.
            assert any(each.branch == command.branch for each in fired) == (change is not None)


def test_entering_a_state_names_only_what_is_nested_in_it() -> None:
    nesting = nesting_of(shipped_blueprint("ratms"))
    assert "placement" in nesting.nested
    found = list(reactions(shipped_blueprint("ratms"), nesting))
    for reaction in found:
        entered = [branch for branch, _ in reaction.entered]
        assert all(branch == reaction.branch or reaction.branch in nesting.around(branch) for branch in entered)
    (connected,) = (each.entered for each in found if each.event == "robot.connect" and each.branch == "robot")
    assert connected == (("robot", "1"),)
