"""Plans of operators: the example plan of a workflow, and arguments for every operation, valid and invalid."""

from __future__ import annotations

import random
from collections.abc import Mapping
from functools import cache
from typing import Any

import msgspec

from pcmrs.fsm import Blueprint
from pcmrs.fsm.behaviour import operations
from pcmrs.testing.plan import Plan, example_plan, read_plan
from pcmrs_lab.experiment.tours.arguments import plan_arguments

BASED_ON = {"ratms": "ratms", "ratms_threshold": "ratms", "grid_mapping": "ratms", "femoroplasty": "femoroplasty"}
"""Workflow whose example plan fits, by workflow."""

WRONG: tuple[dict[str, Any], ...] = (
    {"index": 99},
    {"index": -1},
    {"nonsense": True},
    {"position": [0.0, 0.0, 140.0], "quat_xyzw": [0.0, 0.0, 0.0, 1.0]},
    {"position": [0.0, 0.0, 2.0], "quat_xyzw": [0.0, 0.0, 0.0, 1.0]},
    {"position": [1e300, 0.0, 0.1], "quat_xyzw": [0.0, 0.0, 0.0, 1.0]},
    {"translation": [0.0, 0.0, 0.5]},
    {"landmarks": []},
    {"percent": 101.0},
    {"force": 50.0},
)
"""Arguments that no operation accepts, or not in this cell."""

GARBAGE = (
    b"",
    b";",
    b"\xff\x00\xfe",
    b"img_fid_numxxxxx_99999999999999999999;",
    b"img_fid_pntxxxxx_0_nan_0_0;",
    b"target_rotxxxxxx_1e999_0_0_1_#7;",
    b"unknown_commandx_#9;",
    b"execute_motionxx_#5",
    b"close_the_socket;",
    b"start_registrati_" + b"1" * 300 + b";",
)
"""Datagrams that are not commands."""


@cache
def plan_of(workflow: str) -> Plan:
    """Return the example plan that fits a workflow."""
    return read_plan(example_plan(BASED_ON.get(workflow, "ratms")))


def random_operation(blueprint: Blueprint, draw: random.Random) -> tuple[str, dict[str, Any]]:
    """Return any operation that a client could request, with arguments that mostly fit it.

    Args:
        blueprint: Blueprint of the workflow.
        draw: Source of randomness.
    """
    branch, operation, spec = draw.choice(_requestable(blueprint))
    if draw.random() < 0.25:
        return f"{branch}.{operation}", dict(draw.choice(WRONG))
    return f"{branch}.{operation}", valid_arguments(blueprint.id, spec.payload, draw)


def valid_arguments(workflow: str, payload: str, draw: random.Random) -> dict[str, Any]:
    """Return arguments that fit a payload; empty if none are known.

    Args:
        workflow: Name of the workflow.
        payload: Name of the payload type.
        draw: Source of randomness.
    """
    found: Any = _arguments(workflow).get(payload, {})
    return dict(draw.choice(found) if isinstance(found, list) else found)


def landmark_commands(workflow: str) -> list[tuple[str, tuple[Any, ...]]]:
    """Return the string commands that plan the landmarks."""
    points = [landmark.position for landmark in plan_of(workflow).landmarks]
    each = [("img_fid_pntxxxxx", (index, *map(float, point))) for index, point in enumerate(points)]
    return [("img_fid_numxxxxx", (len(points),)), *each, ("img_fid_lastrecv", ())]


def pose_commands(workflow: str, number: int) -> list[tuple[str, tuple[Any, ...]]]:
    """Return the string commands that plan a pose.

    Args:
        workflow: Name of the workflow.
        number: Index of the pose; it wraps around.
    """
    poses = plan_of(workflow).poses
    pose = poses[number % len(poses)]
    return [
        ("target_rotxxxxxx", tuple(map(float, pose.quat_xyzw))),
        ("target_tslxxxxxx", tuple(map(float, pose.position))),
    ]


@cache
def _arguments(workflow: str) -> Mapping[str, Any]:
    plan = plan_of(workflow)
    own = {"ceiling": {"percent": 60.0, "operator": "explorer"}, "intensity": {"percent": 40.0}}
    found = {**plan_arguments(plan), "surface_points": {"points": 5}, **own}
    return msgspec.json.decode(msgspec.json.encode(found), type=dict[str, Any])  # as read from a script's file


_known: dict[str, list[tuple[str, str, Any]]] = {}


def _requestable(blueprint: Blueprint) -> list[tuple[str, str, Any]]:
    if blueprint.hash not in _known:
        found = operations(blueprint)
        _known[blueprint.hash] = [(branch, name, spec) for branch, name, spec in found if not spec.iio]
    return _known[blueprint.hash]
