"""What operators of a session send: plans by wire, arguments of every kind, and what no link takes."""

from __future__ import annotations

import random

import pytest

from pcmrs.errors import PayloadError
from pcmrs.fsm.behaviour import operations
from pcmrs.gateway.grammar import format_command, parse
from pcmrs_lab.campaign.explore.plans import (
    BASED_ON,
    GARBAGE,
    WRONG,
    landmark_commands,
    plan_of,
    pose_commands,
    random_operation,
    valid_arguments,
)
from tests.unit.lab.blueprints import ratms


@pytest.mark.parametrize("data", GARBAGE)
def test_garbage_is_no_command(data: bytes) -> None:
    with pytest.raises(PayloadError):
        parse(data)


def test_landmarks_are_sent_one_by_one() -> None:
    points = [landmark.position for landmark in plan_of("ratms").landmarks]
    (first, count), *each, (last, _) = landmark_commands("ratms")
    assert (first, count, last) == ("img_fid_numxxxxx", (len(points),), "img_fid_lastrecv")
    assert [tokens for _, tokens in each] == [(index, *map(float, point)) for index, point in enumerate(points)]
    assert all(format_command(name, *tokens) for name, tokens in landmark_commands("ratms"))


def test_poses_are_sent_by_number_and_again_from_the_first() -> None:
    poses = plan_of("ratms").poses
    sent = [pose_commands("ratms", number) for number in range(len(poses) + 1)]
    assert sent[0] == sent[-1]
    assert len({str(each) for each in sent}) == len(poses)
    (turned, quat), (moved, position) = sent[0]
    assert (turned, moved) == ("target_rotxxxxxx", "target_tslxxxxxx")
    assert quat == pytest.approx(poses[0].quat_xyzw)
    assert position == pytest.approx(poses[0].position)


@pytest.mark.parametrize("workflow", [*BASED_ON, "another"])
def test_each_workflow_has_a_plan_that_fits(workflow: str) -> None:
    assert plan_of(workflow) == plan_of(BASED_ON.get(workflow, "ratms"))
    assert plan_of(workflow).poses


def test_every_operation_that_a_client_may_request_is_drawn() -> None:
    requestable = {f"{branch}.{name}": spec for branch, name, spec in operations(ratms()) if not spec.iio}
    draw = random.Random(1)
    drawn = [random_operation(ratms(), draw) for _ in range(1500)]
    assert {name for name, _ in drawn} == set(requestable)
    wrong = [arguments for _, arguments in drawn if arguments in WRONG]
    assert len(wrong) / len(drawn) == pytest.approx(0.25, abs=0.05)
    assert {str(each) for each in wrong} == {str(each) for each in WRONG}


def test_drawn_arguments_may_be_changed() -> None:
    draw = random.Random(1)
    first = valid_arguments("ratms", "intensity", draw)
    first["percent"] = 0.0
    assert valid_arguments("ratms", "intensity", draw) == {"percent": 40.0}
    assert valid_arguments("ratms", "landmark_index", draw) != {}
    assert valid_arguments("ratms", "a payload without any", draw) == {}
