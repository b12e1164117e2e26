"""Properties hold or are broken, and the commands of a finding show it."""

from __future__ import annotations

from typing import Any

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pcmrs.fsm.blueprint import Blueprint, BranchSpec, Condition, OperationSpec, PropertySpec
from pcmrs.fsm.closure import Closure
from pcmrs.fsm.rules import check_rules
from pcmrs.fsm.verify import verify
from pcmrs.fsm.verify._liveness import TimedOperations
from pcmrs.fsm.verify._properties import check_properties
from pcmrs.fsm.verify._space import StateSpace
from tests.support.trials import examples
from tests.unit.fsm.command_trace import CommandTrace, follow_commands
from tests.unit.fsm.large_blueprints import free
from tests.unit.fsm.random_blueprints import blueprints
from tests.unit.fsm.ratms_mutants import changed, revoked, without
from tests.unit.fsm.verify.moment_oracle import after, lengths, some_operations


@examples(60)
@given(blueprints(), st.data())
def test_leads_to_is_violated_by_the_shortest_way(blueprint: Blueprint, data: st.DataObject) -> None:
    observed = some_operations(blueprint, data)
    branch = data.draw(st.sampled_from(list(blueprint.branches)))
    state = data.draw(st.sampled_from(list(blueprint.branches[branch].states)))
    there = Condition(states={branch: [state]})
    spec = PropertySpec(id="leads", when=Condition(running=sorted(observed)), leads_to=there)
    blueprint = msgspec.structs.replace(blueprint, properties=[spec])
    found = [
        each
        for each in check_properties(TimedOperations(StateSpace(blueprint, 10_000)))
        if each.path == ("properties", "0")
    ]
    moments = lengths(blueprint, observed)
    place = list(blueprint.branches).index(branch)
    closed = set(moments)
    ways = {one: [other for other, intended in after(blueprint, observed, one) if intended] for one in moments}
    while opened := {one for one in closed if one[0][place] == state or not closed.issuperset(ways[one])}:
        closed -= opened
    when = [length for moment, length in moments.items() if moment[1]]
    against = [moments[moment] for moment in closed if moment[1]]
    assert [each.code for each in found] == (["property_violated"] if against else [] if when else ["vacuous_property"])
    assert [len(each.commands or ()) for each in found if against] == ([min(against)] if against else [])


def test_watched_operation_adds_no_commands_if_it_is_irrelevant() -> None:
    jump = OperationSpec(from_=["a", "b"], to={"a": "b", "b": "c"})
    walk = OperationSpec(from_=["a", "x", "y"], to={"a": "x", "x": "y", "y": "c"})
    branch = BranchSpec(states=dict.fromkeys("abcxy", "a state"), operations={"jump": jump, "walk": walk})
    spec = PropertySpec(
        id="p",
        when=Condition(running=["main.jump", "main.walk"]),
        never=Condition(states={"main": ["b"]}),
    )
    blueprint = Blueprint(id="ways", version="1.0.0", branches={"main": branch}, properties=[spec])
    (finding,) = check_properties(TimedOperations(StateSpace(blueprint, 100)))
    assert finding.commands == ("main.jump", "main.jump:started")


def test_state_that_breaks_a_promise_is_found_by_shortest_path() -> None:
    """It is the only one of a million joint states."""
    everywhere = Condition(states={f"b{n}": ["s1"] for n in range(20)})
    blueprint = msgspec.structs.replace(free(20, 2), properties=[PropertySpec(id="never", never=everywhere)])
    found = verify(blueprint).findings
    assert [finding.code for finding in found] == ["property_violated"]
    assert sorted(found[0].commands or ()) == sorted(f"b{n}.on" for n in range(20))


def violated(blueprint: Blueprint) -> dict[str, tuple[str, ...] | None]:
    """Properties that do not hold, and the commands that show it."""
    found = [finding for finding in verify(blueprint).findings if finding.code == "property_violated"]
    return {blueprint.properties[int(finding.path[1])].id: finding.commands for finding in found}


def holds(condition: Condition, trace: CommandTrace) -> bool:
    """The condition, stated once more."""
    return (
        all(trace.states[branch] in states for branch, states in condition.states.items())
        and (not condition.running or not trace.running.keys().isdisjoint(condition.running))
        and all(name == "stop" or isinstance(trace.ask(name), Closure) for name in condition.accepted)
    )


def contradicts(spec: PropertySpec, trace: CommandTrace) -> bool:
    other = holds(spec.never, trace) if spec.never else not (spec.always and holds(spec.always, trace))
    return holds(spec.when, trace) and other


def revoke_by_registration_only(branches: dict[str, Any]) -> None:
    branches["placement"]["revocations"][0]["by"] = ["registration"]
    for name in ("plan", "use_previous"):
        branches["toolplan"]["operations"][name]["outcomes"]["replanned"].pop("revoked_to")


READY = {"approach_only_when_ready", "at_the_body_only_when_ready"}
BACK_OFF = "back_off"
BROKEN = {
    "approach without its requirement": (without("placement", "approach", "requires"), READY, 3),
    "toolplan revokes nothing": (
        changed(revoke_by_registration_only),
        {"at_the_body_only_when_ready", "engaged_only_when_guided"},
        6,
    ),
    "registration revokes nothing": (
        revoked(by=["toolplan"]),
        {"at_the_body_only_when_ready", "aligned_only_at_the_body", "engaged_only_when_guided"},
        6,
    ),
    "standoff is not revoked": (
        revoked(**{"from": ["placed"]}),
        {"at_the_body_only_when_ready", "aligned_only_at_the_body", "engaged_only_when_guided"},
        6,
    ),
    "held fits a robot that is not connected": (
        changed(lambda b: b["placement"]["parent"]["compatible"].update(held=["0", "1"])),
        {"never_at_the_body_unconnected", "retreat_always_accepted"},
        3,
    ),
    "no way back from held": (
        changed(lambda b: b["placement"]["operations"][BACK_OFF].update({"from": ["standoff", "placed"]})),
        {"retreat_always_accepted", "held_leads_to_retracted"},
        2,
    ),
    "back off to standoff whatever the plan": (
        changed(lambda b: b["placement"]["operations"][BACK_OFF]["outcomes"]["standoff"].pop("requires")),
        {"at_the_body_only_when_ready"},
        3,
    ),
}


@pytest.mark.parametrize("name", BROKEN)
def test_a_change_breaks_these_promises_and_the_commands_show_it(name: str) -> None:
    blueprint, expected, length = BROKEN[name]
    assert list(check_rules(blueprint)) == []
    found = violated(blueprint)
    assert set(found) == expected
    assert min(len(commands or ()) for commands in found.values()) == length
    for spec in blueprint.properties:
        if spec.id in found:
            assert contradicts(spec, follow_commands(blueprint, found[spec.id] or ()))


def test_without_a_way_off_the_body_a_held_tool_stays_there() -> None:
    def keep(branches: dict[str, Any]) -> None:
        branches["placement"]["operations"][BACK_OFF].update(outcomes={"held": {"to": "held"}}, on_unknown="held")
        branches["robot"]["operations"].pop("link_lost")

    assert set(violated(changed(keep))) == {"held_leads_to_retracted"}


def test_state_that_nothing_leads_to_is_unreachable() -> None:
    blueprint = changed(lambda b: b["placement"]["operations"]["confirm"].update(to="standoff"))
    assert set(violated(blueprint)) == {"placed_reachable"}
