"""RATMS keeps its promises, and each of them is broken by the change that should break it."""

from __future__ import annotations

from typing import Any

import pytest

from pcmrs.fsm.blueprint import Blueprint, Condition, PropertySpec
from pcmrs.fsm.closure import Closure
from pcmrs.fsm.rules import check_rules
from pcmrs.fsm.verify import verify
from tests.unit.fsm.command_trace import CommandTrace, follow_commands
from tests.unit.fsm.ratms_mutants import changed, mutants, ratms, revoked, without


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


def test_ratms_is_sound() -> None:
    found = verify(ratms())
    assert found.findings == []
    assert found.joint_states == 39


READY = {"approach_only_when_ready", "at_the_body_only_when_ready"}
BACK_OFF = "back_off"
BROKEN = {
    "approach without its requirement": (without("placement", "approach", "requires"), READY, 3),
    "toolplan revokes nothing": (
        revoked(by=["registration"]),
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


@pytest.mark.parametrize(("name", "blueprint"), list(mutants()), ids=[name for name, _ in mutants()])
def test_every_command_sequence_of_a_mutant_can_be_followed(name: str, blueprint: Blueprint) -> None:
    for finding in verify(blueprint).findings:
        if finding.commands is not None:
            follow_commands(blueprint, finding.commands)
