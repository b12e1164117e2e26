"""Activities in a blueprint: what cannot be meant is named, and every view of a workflow shows them."""

from __future__ import annotations

from random import Random

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pcmrs.authoring.chart import dot, mermaid, svg
from pcmrs.authoring.difference import compare
from pcmrs.authoring.exchange.exporting.scxml import scxml
from pcmrs.authoring.exchange.exporting.table import table
from pcmrs.authoring.exchange.importing.mermaid import from_mermaid
from pcmrs.authoring.exchange.importing.scxml import from_scxml
from pcmrs.authoring.trial.tour import plan_tour
from pcmrs.fsm import Blueprint, Denial, examine, parse_blueprint
from pcmrs.fsm.behaviour import behaviour
from pcmrs.fsm.blueprint import ActivitySpec
from pcmrs.fsm.classes import source_of, states_of
from pcmrs.fsm.files.dump import blueprint_toml
from pcmrs.fsm.verify import verify
from tests.support.altered import with_branch
from tests.support.trials import examples
from tests.unit.fsm.random_blueprints import blueprints

SOUND = """
id = "arm"
version = "1"

[branches.robot]
states = { ready = "connected", off = "not connected" }
[branches.robot.operations.acknowledge]
from = ["ready"]
to = "ready"
unlatches = true
[branches.robot.operations.disconnect]
from = ["ready"]
to = "off"
[branches.robot.operations.connect]
from = ["off"]
to = "ready"
[branches.robot.operations.changed]
from = ["*"]
to = "ready"
iio = true

[branches.arm]
level = 2
emits = { "*" = "changed" }
[branches.arm.states]
away = "clear"
near = "at the body"
following = "moves with the body"
held = "let go"
stopped = "stopped"
[branches.arm.parent]
branch = "robot"
start = "off"
compatible = { away = ["ready", "off"], "*" = ["ready"] }
[branches.arm.activities]
near = { run = "watch_head", ended = "lost_sight" }
following = { run = "follow_head", ended = "lost", moves = true }
[branches.arm.operations.approach]
from = ["away", "held"]
to = "near"
motion = "approach"
steps = ["move"]
on_failure = "stopped"
on_unknown = "stopped"
[branches.arm.operations.follow]
from = ["near"]
to = "following"
motion = "approach"
steps = ["move"]
on_failure = "stopped"
on_unknown = "stopped"
[branches.arm.operations.withdraw]
from = ["near", "following", "held", "stopped"]
to = "away"
motion = "retreat"
steps = ["move"]
on_failure = "stopped"
on_unknown = "stopped"
[branches.arm.operations.lost]
from = ["following"]
to = "held"
event = true
[branches.arm.operations.lost_sight]
from = ["near"]
to = "held"
event = true
[branches.arm.operations.reinit]
from = ["*"]
to = "away"
rio = true
"""

FAULTS = {
    # what is replaced, by what, the code of the finding, a part of its text
    "unknown state": ("near = { run", "far = { run", "unknown_state", "'far'"),
    "every state": ("near = { run", '"*" = { run', "unknown_state", "'*'"),
    "unknown operation": ('ended = "lost_sight"', 'ended = "gone"', "unknown_operation", "arm.gone"),
    "no name of a function": ('"watch_head"', '"watch--head"', "bad_name", "'watch--head'"),
    "where the branch starts": ("near = { run", "away = { run", "bad_activity", "never run in the starting state"),
    "ended is no event": ('ended = "lost_sight"', 'ended = "withdraw"', "bad_activity", "not an event"),
    "ended is not valid there": ('ended = "lost_sight"', 'ended = "lost"', "bad_activity", "not valid in that state"),
    "ended keeps the state": ('from = ["near"]\nto = "held"', 'from = ["near"]\nto = "near"', "bad_activity", "keep"),
    "ended may fail": ('to = "held"\nevent', 'to = "held"\nsteps = ["see"]\nevent', "bad_activity", "may keep"),
    "ended may be refused": ('to = "held"\nevent', 'to = "held"\nchecks = ["see"]\nevent', "bad_activity", "checks"),
    "ended requires more": (
        'to = "held"\nevent',
        'to = "held"\nrequires = { robot = ["ready"] }\nevent',
        "bad_activity",
        "requires",
    ),
    "ended moves": (
        'to = "held"\nevent',
        'to = "held"\naffects_patient = true\nevent',
        "bad_operation",
        "no user asks for it",
    ),
    "entered without an approach": (
        'to = "following"\nmotion = "approach"',
        'to = "following"\nmotion = "retreat"',
        "bad_activity",
        "follow leads there, and not as an approach",
    ),
    "entered by a failure": (
        'to = "near"\nmotion = "approach"\nsteps = ["move"]\non_failure = "stopped"',
        'to = "near"\nmotion = "approach"\nsteps = ["move"]\non_failure = "following"',
        "bad_activity",
        "approach leads there, and not as an approach that ends",
    ),
    "kept by a motion": (
        'from = ["near"]\nto = "following"',
        'from = ["near", "following"]\nto = "following"',
        "bad_activity",
        "follow takes over from it",
    ),
    "kept by a motion that fails": (
        '"stopped"]\nto = "away"\nmotion = "retreat"\nsteps = ["move"]\non_failure = "stopped"',
        '"stopped"]\nto = "away"\nmotion = "retreat"\nsteps = ["move"]\non_failure = { near = "stopped", '
        'following = "following", held = "stopped", stopped = "stopped" }',
        "bad_activity",
        "withdraw takes over from it",
    ),
    "entered by a revocation": (
        "[branches.arm.states]",
        'revocations = [{ by = ["robot"], from = ["held"], to = "following" }]\n[branches.arm.states]',
        "bad_activity",
        "another branch takes this one there",
    ),
    "set from above": (
        'from = ["off"]\nto = "ready"',
        'from = ["off"]\nto = "ready"\nsets = { arm = "following" }',
        "bad_activity",
        "another branch takes this one there",
    ),
    "beside the motion of another branch": (
        "[branches.robot.operations.disconnect]",
        '[branches.robot.operations.home]\nfrom = ["ready"]\nto = "ready"\nmotion = "retreat"\nsteps = ["move"]\n'
        'on_failure = "off"\non_unknown = "off"\n[branches.robot.operations.disconnect]',
        "bad_activity",
        "robot.home moves the robot",
    ),
    "unknown key": ("moves = true", "move = true", "bad_value", "move"),
}


def blueprint() -> Blueprint:
    return parse_blueprint(SOUND.encode())


@pytest.mark.parametrize("fault", FAULTS)
def test_a_fault_is_named(fault: str) -> None:
    old, new, code, words = FAULTS[fault]
    assert old in SOUND
    findings = examine(SOUND.replace(old, new).encode()).findings
    assert [(finding.code, words in finding.text) for finding in findings[:1]] == [(code, True)], findings
    assert {finding.code for finding in findings} == {code}
    assert all(finding.line > 1 for finding in findings)


def test_motion_elsewhere_is_sound_if_it_requires_standstill() -> None:
    old, new, *_ = FAULTS["beside the motion of another branch"]
    allowed = new.replace('motion = "retreat"', 'requires = { arm = ["away"] }\nmotion = "retreat"')
    assert examine(SOUND.replace(old, allowed).encode()).sound


def test_activities_that_move_belong_to_one_branch() -> None:
    lost = "[branches.robot.operations.lost]\nfrom = ['off']\nto = 'ready'\nevent = true\n"
    activities = "activities = { off = { run = 'heat', ended = 'lost', moves = true } }\n"
    text = SOUND.replace("[branches.robot]\n", f"[branches.robot]\n{activities}")
    text = text.replace("[branches.robot.operations.disconnect]", f"{lost}[branches.robot.operations.disconnect]")
    texts = [finding.text for finding in examine(text.encode()).findings if finding.code == "bad_activity"]
    assert any("keep those of one branch" in said for said in texts)


@given(blueprints(), st.randoms(use_true_random=False))
@examples(100)
def test_where_its_end_is_denied_it_is_stuck(blueprint: Blueprint, rng: Random) -> None:
    """Against the answers of every joint state, one by one."""
    name = rng.choice(list(blueprint.branches))
    branch = blueprint.branches[name]
    state, ended = rng.choice(list(branch.states)), rng.choice(list(branch.operations))
    with_one = with_branch(blueprint, name, activities={state: ActivitySpec(run="go_on", ended=ended)})
    found = verify(with_one).findings
    if branch.operations[ended].iio or {"endless_cascade", "no_outcome"} & {finding.code for finding in found}:
        return
    place = list(blueprint.branches).index(name)
    here = [answers for joint, answers in behaviour(blueprint).items() if joint[place] == state]
    stuck = any(isinstance(answers[f"{name}.{ended}"], Denial) for answers in here)
    assert [finding.path for finding in found if finding.code == "activity_stuck"] == (
        [("branches", name, "activities", state)] if stuck else []
    )


def test_the_hash_is_of_activities_too() -> None:
    changed = SOUND.replace("watch_head", "see_head")
    assert parse_blueprint(changed.encode()).hash != blueprint().hash


def test_activities_are_read_back_as_written() -> None:
    written = blueprint_toml(blueprint())
    assert "[branches.arm.activities]\nnear = {" in written
    assert parse_blueprint(written.encode()) == blueprint()


def test_generated_class_names_the_activities() -> None:
    source = source_of(blueprint())
    assert "# do / follow_head, which moves the robot; when that ends by itself, lost" in source
    assert "# do / watch_head; when that ends by itself, lost_sight" in source
    assert len(states_of(blueprint())["arm"]) == 5


def test_every_view_shows_them() -> None:
    for drawn in (svg(blueprint()), dot(blueprint()), scxml(blueprint())):
        assert drawn.count("do / follow_head") == 1
        assert drawn.count("do / watch_head") == 1
    assert "note right of arm_IS_following : do / follow_head" in mermaid(blueprint())
    rows = [line for line in table(blueprint()).splitlines() if "follow_head" in line]
    assert rows == [
        "| arm | activity (moves) | following |  |  | follow_head | being in the state | lost when it ends |"
    ]


def test_a_chart_with_them_is_read_again_without() -> None:
    alone = parse_blueprint(
        b"""id = "x"
version = "1"
goal = { x = ["b"] }
[branches.x]
states = { a = "", b = "" }
activities = { b = { run = "watch", ended = "lost" } }
[branches.x.operations.go]
from = ["a"]
to = "b"
[branches.x.operations.lost]
from = ["b"]
to = "a"
event = true
"""
    )
    for read, drawn in ((from_scxml, scxml(alone)), (from_mermaid, mermaid(alone))):
        again, findings = read(drawn.encode())
        assert again is not None, findings
        assert not any(branch.activities for branch in again.branches.values())


def test_an_invoke_is_not_supported_where_it_is() -> None:
    document = '<scxml xmlns="http://www.w3.org/2005/07/scxml">\n<state id="a">\n<invoke src="x"/></state></scxml>'
    _, findings = from_scxml(document.encode())
    assert [(finding.code, finding.line) for finding in findings] == [("not_supported", 3)]


def test_a_difference_in_them_is_one_in_behaviour() -> None:
    without = with_branch(blueprint(), "arm", activities={"near": blueprint().branches["arm"].activities["near"]})
    said = [difference.text for difference in compare(blueprint(), without)]
    assert said == [
        "arm.[following]: activity changed from follow_head to None",
        "arm.[following]: ended by changed from lost to None",
        "arm.[following]: moves changed from True to None",
    ]
    near = msgspec.structs.replace(blueprint().branches["arm"].activities["near"], run="see_head")
    other = with_branch(blueprint(), "arm", activities={**blueprint().branches["arm"].activities, "near": near})
    assert [difference.subject for difference in compare(other, blueprint())] == ["arm.[near]"]
    assert compare(blueprint(), blueprint()) == []


def test_a_tour_covers_a_workflow_that_has_them() -> None:
    still = with_branch(blueprint(), "arm", activities={})
    assert plan_tour(blueprint()) == plan_tour(still)
