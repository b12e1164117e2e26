"""What can happen while operations run, against a search that does it one moment at a time."""

from __future__ import annotations

from collections.abc import Iterator

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pcmrs.fsm.behaviour import branch_states, endings, joint_of
from pcmrs.fsm.blueprint import Blueprint, BranchSpec, Condition, OperationSpec, PropertySpec
from pcmrs.fsm.closure import Closure, close
from pcmrs.fsm.verify import search, verify
from pcmrs.fsm.verify.liveness import TimedOperations
from pcmrs.fsm.verify.properties import check_properties
from pcmrs.fsm.verify.space import Space
from tests.support.trials import examples
from tests.unit.fsm.large_blueprints import free
from tests.unit.fsm.random_blueprints import blueprints
from tests.unit.fsm.ratms_mutants import ratms

Locks = tuple[frozenset[str], frozenset[str]]
Moment = tuple[tuple[str, ...], frozenset[tuple[str, Locks]]]


def after(blueprint: Blueprint, observed: frozenset[str], moment: Moment) -> Iterator[tuple[Moment, bool]]:
    """Every moment that can follow, said anew: locks of what runs bar what would begin or be committed.

    And whether it follows on what a user asks for or has asked for, and ends as declared.
    """
    joint, running = moment
    states, held = branch_states(blueprint, joint), dict(running)
    for branch, spec in blueprint.branches.items():
        for operation, declared in spec.operations.items():
            name, closure = f"{branch}.{operation}", close(blueprint, states, branch, operation)
            if declared.iio or not isinstance(closure, Closure):
                continue
            others = [locks for other, locks in held.items() if other != name]
            needed = (closure.writes, frozenset[str]()) if name in held else (closure.writes, closure.reads)
            if any(needed[0] & (writes | reads) or needed[1] & writes for writes, reads in others):
                continue
            if name in observed and name not in held:
                yield (joint, running | {(name, (closure.writes, closure.reads))}), not declared.event
            for ending, change in endings(declared, closure).items():
                target = joint if change is None else joint_of(blueprint, change.states)
                intended = ending in closure.outcomes and (name in held or not declared.event)
                yield (target, frozenset((other, locks) for other, locks in running if other != name)), intended


def lengths(blueprint: Blueprint, observed: frozenset[str]) -> dict[Moment, int]:
    start: Moment = (joint_of(blueprint, blueprint.initial()), frozenset())
    found, waiting = {start: 0}, [start]
    for moment in waiting:
        for following, _ in after(blueprint, observed, moment):
            if following not in found:
                found[following] = found[moment] + 1
                waiting.append(following)
    return found


def some_operations(blueprint: Blueprint, data: st.DataObject) -> frozenset[str]:
    names = [
        f"{branch}.{operation}"
        for branch, spec in blueprint.branches.items()
        for operation, declared in spec.operations.items()
        if not declared.iio
    ]
    return data.draw(st.frozensets(st.sampled_from(names), min_size=1, max_size=2))


def stranded(blueprint: Blueprint, moment: Moment) -> bool:
    joint, running = moment
    asked = (name.split(".") for name, _ in running)
    states = branch_states(blueprint, joint)
    return any(not isinstance(close(blueprint, states, name[0], name[1]), Closure) for name in asked)


@examples(40)
@given(blueprints(), st.data())
def test_finds_every_moment_on_its_level(blueprint: Blueprint, data: st.DataObject) -> None:
    check_moments(blueprint, some_operations(blueprint, data))


@pytest.mark.parametrize("other", ["digitization.digitize_all", "registration.use_previous", "placement.approach"])
def test_a_commit_waits_for_what_runs_on_a_branch_it_would_move(other: str) -> None:
    """A way home runs while a registration changes on which the standoff it began at rests: it can be concluded."""
    observed = frozenset({"placement.home", other})
    check_moments(ratms(), observed)
    moments = TimedOperations(Space(ratms(), 100)).moments(observed)
    assert not any(moments.stranded(batch).any() for batch in moments.reached.batches())


def check_moments(blueprint: Blueprint, observed: frozenset[str]) -> None:
    """The moments of both searches are the same, and so are the lengths of the shortest ways to them."""
    moments = TimedOperations(Space(blueprint, 10_000)).moments(observed)
    found = {
        (joint_of(blueprint, values), frozenset((name, locks) for name, locks in running)): length
        for length, level in enumerate(moments.reached.levels)
        for values, running in map(moments.decoded, level.tolist())
    }
    assert found == lengths(blueprint, observed)


@examples(40)
@given(blueprints(), st.data())
def test_operations_protected_by_locks_need_no_search(blueprint: Blueprint, data: st.DataObject) -> None:
    """Only operations that are called strandable can be found where they are denied."""
    runs = TimedOperations(Space(blueprint, 10_000))
    for branch, spec in blueprint.branches.items():
        for operation, declared in spec.operations.items():
            name = f"{branch}.{operation}"
            if declared.steps and name not in runs.strandable:
                found = lengths(blueprint, frozenset({name}))
                assert not any(stranded(blueprint, moment) for moment in found)


@examples(40)
@given(blueprints(), st.data())
def test_conditions_hold_at_the_same_moments(blueprint: Blueprint, data: st.DataObject) -> None:
    observed = some_operations(blueprint, data)
    moments = TimedOperations(Space(blueprint, 10_000)).moments(observed)
    branch = data.draw(st.sampled_from(list(blueprint.branches)))
    states = data.draw(st.lists(st.sampled_from(list(blueprint.branches[branch].states)), max_size=2))
    condition = Condition(states={branch: states}, running=sorted(observed))
    expected = sum(
        branch_states(blueprint, joint)[branch] in states and bool(running)
        for joint, running in lengths(blueprint, observed)
    )
    assert sum(int(moments.hold(condition, batch).sum()) for batch in moments.reached.batches()) == expected
    at_stop = sum(not stranded(blueprint, moment) for moment in lengths(blueprint, observed))
    stop = Condition(accepted=["stop"])
    assert sum(int(moments.hold(stop, batch).sum()) for batch in moments.reached.batches()) == at_stop


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
        each for each in check_properties(TimedOperations(Space(blueprint, 10_000))) if each.path == ("properties", "0")
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
    (finding,) = check_properties(TimedOperations(Space(blueprint, 100)))
    assert finding.commands == ("main.jump", "main.jump:started")


@pytest.mark.parametrize("count", [5, 6])
def test_all_searches_together_are_limited(count: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(search, "MIN_BUDGET", 14_000)
    specs = [
        PropertySpec(id=f"p{n}", when=Condition(running=[f"b{n}.on"]), leads_to=Condition(states={"b7": ["s1"]}))
        for n in range(count)
    ]
    blueprint = msgspec.structs.replace(free(8, 2), properties=specs, goal={"b0": ["s0"]})
    found = [(finding.code, finding.text.partition(":")[0]) for finding in verify(blueprint, limit=300).findings]
    refused = ("too_many_states", "The properties watch too many joint states and running operations")
    assert found == ([refused] if count == 6 else [])


def test_an_operation_that_is_only_called_by_children_never_runs() -> None:
    runs = TimedOperations(Space(ratms(), 100))
    moments = runs.moments(frozenset({"registration.digitized"}))
    spec = PropertySpec(id="never", never=Condition(running=["registration.digitized"]))
    assert spec.never is not None
    assert not any(moments.hold(spec.never, batch).any() for batch in moments.reached.batches())
