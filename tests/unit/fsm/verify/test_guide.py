"""The way on that the guide shows is a shortest one that the workflow allows, in every reachable joint state."""

from __future__ import annotations

import heapq
from collections.abc import Iterator, Mapping
from functools import cache

import msgspec
import pytest
from hypothesis import given

from pcmrs.fsm import Blueprint, Closure, Guide, examine, guide_for, parse_blueprint
from pcmrs.fsm.behaviour import Joint, behaviour, branch_states, joint_of
from pcmrs.fsm.files.load import content_hash
from tests import ROOT
from tests.support.shipped import NAMES, shipped_blueprint, unverified_blueprint
from tests.support.trials import examples
from tests.unit.fsm.random_blueprints import blueprints

Moves = dict[Joint, list[tuple[str, Joint]]]
"""Joint state to the operations that users are led through there, each with a joint state that it may lead to."""

BIOPSY = ROOT / "examples/biopsy/biopsy.toml"


def moves_of(blueprint: Blueprint) -> Moves:
    """The graph that hints are compared with, worked out one joint state at a time."""
    return {
        joint: [
            (name, joint_of(blueprint, change.states))
            for name, answer in answers.items()
            if isinstance(answer, Closure) and _is_led_through(blueprint, name)
            for change in answer.outcomes.values()
        ]
        for joint, answers in behaviour(blueprint).items()
    }


def _is_led_through(blueprint: Blueprint, name: str) -> bool:
    spec = blueprint.find(*name.split("."))
    assert spec is not None
    return not spec.iio and (not spec.event or name in blueprint.guided)


def cost(blueprint: Blueprint, name: str) -> tuple[int, int]:
    """Steps that no stage names, and steps: the first count before the second does."""
    return (0 if name in blueprint.guided or not blueprint.guided else 1, 1)


def shortest(blueprint: Blueprint, moves: Moves, goal: set[Joint]) -> dict[Joint, tuple[int, int]]:
    """Costs of the cheapest way from each joint state from which there is one: Dijkstra, backwards."""
    before: dict[Joint, list[tuple[str, Joint]]] = {joint: [] for joint in moves}
    for joint, steps in moves.items():
        for name, after in steps:
            before[after].append((name, joint))
    found: dict[Joint, tuple[int, int]] = {}
    waiting = [((0, 0), joint) for joint in goal]
    heapq.heapify(waiting)
    while waiting:
        so_far, joint = heapq.heappop(waiting)
        if joint in found:
            continue
        found[joint] = so_far
        for name, earlier in before[joint]:
            extra = cost(blueprint, name)
            heapq.heappush(waiting, ((so_far[0] + extra[0], so_far[1] + extra[1]), earlier))
    return found


def follow(moves: Moves, joint: Joint, path: tuple[str, ...]) -> set[Joint]:
    """Joint states that the operations of a path may lead to, each allowed after those before it."""
    here = {joint}
    for name in path:
        here = {after for each in here for taken, after in moves[each] if taken == name}
    return here


def total(blueprint: Blueprint, path: tuple[str, ...]) -> tuple[int, int]:
    costs = [cost(blueprint, name) for name in path]
    return sum(first for first, _ in costs), len(costs)


def meets(blueprint: Blueprint, joint: Joint, requirement: Mapping[str, list[str]]) -> bool:
    states = branch_states(blueprint, joint)
    return all(states[branch] in wanted for branch, wanted in requirement.items())


def check_stages(blueprint: Blueprint, guide: Guide, moves: Moves) -> None:
    ways = {
        stage.id: shortest(blueprint, moves, {joint for joint in moves if meets(blueprint, joint, stage.goal)})
        for stage in blueprint.stages
    }
    for joint in moves:
        found = guide.next_stage(branch_states(blueprint, joint))
        here = [stage for stage in blueprint.stages if meets(blueprint, joint, stage.when)]
        expected = next((stage for stage in here if not meets(blueprint, joint, stage.goal)), None)
        assert found.stage == expected
        if expected is None or joint not in ways[expected.id]:
            assert found.path == ()
            continue
        assert total(blueprint, found.path) == ways[expected.id][joint]
        assert any(meets(blueprint, after, expected.goal) for after in follow(moves, joint, found.path))


def requestable(blueprint: Blueprint) -> Iterator[str]:
    for branch, declared in blueprint.branches.items():
        yield from (f"{branch}.{name}" for name, spec in declared.operations.items() if not (spec.iio or spec.event))


def check_operations(blueprint: Blueprint, guide: Guide, moves: Moves) -> None:
    for name in requestable(blueprint):
        ways = shortest(blueprint, moves, {joint for joint, steps in moves.items() if name in dict(steps)})
        for joint in moves:
            path = guide.to_operation(branch_states(blueprint, joint), name).path
            if joint not in ways:
                assert path == ()
                continue
            assert path[-1] == name
            assert total(blueprint, path[:-1]) == ways[joint]
            assert follow(moves, joint, path)


def check_releases(blueprint: Blueprint, guide: Guide, moves: Moves) -> None:
    """While Stop is latched, the way leads out of it, through nothing that it forbids."""
    for joint in moves:
        path = guide.next_stage(branch_states(blueprint, joint), latched=True).path
        assert path[-1] in blueprint.unlatching
        assert follow(moves, joint, path)
        for name in path:
            spec = blueprint.find(*name.split("."))
            assert spec is not None
            assert not spec.blocked_when_latched


@cache
def opened(name: str) -> tuple[Blueprint, Guide, Moves]:
    blueprint = unverified_blueprint(BIOPSY) if name == "biopsy" else shipped_blueprint(name)
    return blueprint, guide_for(blueprint), moves_of(blueprint)


@pytest.mark.parametrize("name", [*NAMES, "biopsy"])
def test_hint_is_a_shortest_way_to_the_next_stage(name: str) -> None:
    check_stages(*opened(name))


@pytest.mark.parametrize("name", [*NAMES, "biopsy"])
def test_hint_is_a_shortest_way_to_each_operation(name: str) -> None:
    check_operations(*opened(name))


@pytest.mark.parametrize("name", [*NAMES, "biopsy"])
def test_hint_after_a_stop_leads_to_its_release(name: str) -> None:
    check_releases(*opened(name))


@examples(30)
@given(blueprints())
def test_hints_are_right_in_random_workflows(blueprint: Blueprint) -> None:
    moves = moves_of(blueprint)
    check_operations(blueprint, Guide(blueprint), moves)
    some = next(iter(blueprint.branches.items()))
    aimed = msgspec.structs.replace(blueprint, goal={some[0]: [list(some[1].states)[-1]]})
    check_stages(aimed, Guide(aimed), moves)


RATMS = shipped_blueprint("ratms")


def states(**given: str) -> dict[str, str]:
    return RATMS.initial() | given


REGISTERED = {"registration": "111", "digitization": "1", "toolplan": "1"}


@pytest.mark.parametrize(
    ("given_states", "following"),
    [
        ({}, "registration.plan_landmarks"),
        ({"registration": "100"}, "toolplan.plan"),
        ({"registration": "100", "toolplan": "1"}, "digitization.digitize_one"),
        ({"registration": "110", "digitization": "1", "toolplan": "1"}, "registration.register"),
        (REGISTERED, "robot.connect"),
        (REGISTERED | {"robot": "1"}, "placement.locate"),
        (REGISTERED | {"robot": "1", "placement": "held"}, "placement.back_off"),
        (REGISTERED | {"robot": "1", "placement": "retracted"}, "placement.approach"),
        (REGISTERED | {"robot": "1", "placement": "standoff"}, "placement.confirm"),
        (REGISTERED | {"robot": "1", "placement": "placed"}, "placement.home"),
    ],
)
def test_ratms_is_led_as_its_users_work(given_states: dict[str, str], following: str) -> None:
    assert guide_for(RATMS).next_stage(states(**given_states)).next == following


def test_refused_approach_is_led_to_the_connection_first() -> None:
    found = guide_for(RATMS).to_operation(states(**REGISTERED), "placement.approach")
    assert found.path == ("robot.connect", "placement.locate", "placement.approach")


def test_release_of_a_stop_is_preceded_by_the_connection() -> None:
    guide = guide_for(RATMS)
    assert guide.next_stage(states(), latched=True).path == ("robot.connect", "robot.acknowledge")
    assert guide.to_operation(states(), "placement.approach", latched=True).next == "robot.connect"
    assert guide.to_operation(states(), "toolplan.plan", latched=True).path == ("toolplan.plan",)


def test_unknown_operation_or_joint_state_has_no_way() -> None:
    guide = guide_for(RATMS)
    for name in ("robot.link_lost", "registration.digitized", "robot.fly", "robot"):
        assert guide.to_operation(states(), name).path == ()
    impossible = states(placement="placed")
    assert guide.to_operation(impossible, "placement.approach").path == ()
    assert guide.next_stage(impossible).path == ()


def test_workflow_without_stages_is_led_to_its_goal() -> None:
    bare = msgspec.structs.replace(RATMS, stage=msgspec.UNSET)
    found = Guide(bare).next_stage(states(**REGISTERED))
    assert found.stage is not None
    assert found.stage.goal == RATMS.goal
    assert found.path[-1] == "placement.confirm"
    aimless = msgspec.structs.replace(bare, goal={})
    assert Guide(aimless).next_stage(states()).path == ()


def test_too_many_joint_states_mean_no_hints(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("pcmrs.fsm.verify.guide.MAX_JOINT_STATES", 10)
    guide = Guide(RATMS)
    assert guide.next_stage(states()).path == ()
    assert guide.to_operation(states(), "robot.connect").path == ()


def test_stages_do_not_change_the_hash() -> None:
    bare = msgspec.structs.replace(RATMS, stage=msgspec.UNSET)
    assert content_hash(bare) == content_hash(RATMS) == RATMS.hash


STAGED = b"""
id = "door"
version = "1.0.0"

[branches.door.states]
closed = "closed"
open = "open"

[branches.door.operations.open]
from = ["closed"]
to = "open"

[branches.door.operations.close]
from = ["open"]
to = "closed"

[[stage]]
id = "enter"
goal = { door = ["open"] }
operations = ["door.open"]
"""


@pytest.mark.parametrize(
    ("old", "new", "code"),
    [
        ("door.open", "door.opne", "unknown_operation"),
        ('door = ["open"]', 'door = ["ajar"]', "unknown_state"),
        ('door = ["open"]', "", "bad_stage"),
        ('"enter"', '"Enter"', "bad_name"),
    ],
)
def test_faulty_stage_is_found_at_its_line(old: str, new: str, code: str) -> None:
    assert parse_blueprint(STAGED).declared_stages
    place = STAGED.rindex(old.encode())
    faulty = STAGED[:place] + STAGED[place:].replace(old.encode(), new.encode(), 1)
    (finding,) = examine(faulty).findings
    assert finding.code == code
    assert finding.line >= faulty[: faulty.index(b"[[stage]]")].count(b"\n")
