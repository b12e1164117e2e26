"""The core of the Slicer module against the daemon's own grammar, streams and transforms; no daemon runs here."""

from __future__ import annotations

import ast
import math
import socket
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pyigtl.messages import CRC64

from pcmrs.gateway.commands import COMMANDS
from pcmrs.gateway.grammar import CommandOutcome, parse
from pcmrs.gateway.streams import point_message, pose_message
from pcmrs.spatial import Transform
from pcmrs.testing.daemon import free_port
from tests.system.clients.slicer_program import MODULE, core

link = core()
CLIENTS = MODULE.parents[1]
COORDINATE = st.floats(-500.0, 500.0)
POINT = st.tuples(COORDINATE, COORDINATE, COORDINATE)
ROTATION = st.tuples(*[st.floats(-3.0, 3.0)] * 3)


class Recorder:
    """Stands where a link does, and keeps the commands of the jobs that a planner begins."""

    def __init__(self) -> None:
        self.requests: list[Any] = []

    def begin(self, title: str, *steps: Any, then: Any) -> None:
        datagrams = [link.messages.command(step.name, *step.values, number=7) for step in steps]
        self.requests = [parse(datagram) for datagram in datagrams]


@given(st.lists(POINT, min_size=1, max_size=12))
def test_landmarks_in_mm_are_what_the_daemon_reads_in_metres(points: list[tuple[float, ...]]) -> None:
    recorder = Recorder()
    link.Planner(recorder).plan_landmarks(points)
    first, *parts, last = recorder.requests
    assert (first.spec.name, first.values) == ("img_fid_numxxxxx", (len(points),))
    assert last.spec.name == "img_fid_lastrecv"
    assert [part.values[0] for part in parts] == list(range(len(points)))
    assert np.allclose([part.values[1:] for part in parts], np.array(points) * 1e-3, rtol=0.0, atol=1e-12)


@given(ROTATION, POINT)
def test_scene_transform_is_the_pose_that_the_daemon_plans(
    turn: tuple[float, ...], position: tuple[float, ...]
) -> None:
    meant = Transform.from_rotvec(np.array(position) * 1e-3, turn)
    matrix = meant.matrix
    matrix[:3, 3] *= 1e3
    recorder = Recorder()
    link.Planner(recorder).plan_tool(link.pose_of_matrix(matrix.tolist()))
    rotation, translation = recorder.requests
    read = Transform.from_quat_xyzw(translation.values, rotation.values)
    assert np.allclose(read.matrix, meant.matrix, rtol=0.0, atol=1e-9)


@given(ROTATION, POINT)
def test_streams_are_read_as_they_are_meant(turn: tuple[float, ...], position: tuple[float, ...]) -> None:
    pose = Transform.from_rotvec(np.array(position) * 1e-3, turn)
    tool = link.messages.parse_stream(pose_message(pose).encode())
    tip = link.messages.parse_stream(point_message(pose.translation).encode())
    assert (tool.kind, tip.kind) == ("tool", "tip")
    assert np.allclose(np.array(tool.value.matrix)[:3, :3], pose.rotation, rtol=0.0, atol=5e-5)
    assert np.allclose(tool.value.position, position, rtol=0.0, atol=1e-5)
    assert np.allclose(tip.value, position, rtol=0.0, atol=1e-5)


@given(POINT, POINT, st.floats(-math.pi, math.pi))
def test_a_tool_on_a_line_points_away_from_the_body(
    target: tuple[float, ...], away: tuple[float, ...], turn: float
) -> None:
    axis = np.array(away) - target
    if np.linalg.norm(axis) < 1.0:
        with pytest.raises(link.PoseError):
            link.pose_of_line(target, away, turn)
        return
    matrix = np.array(link.pose_of_line(target, away, turn).matrix)
    assert np.allclose(matrix[:3, 2], axis / np.linalg.norm(axis), atol=1e-9)
    assert np.allclose(matrix[:3, 3], target)
    assert np.linalg.det(matrix[:3, :3]) == pytest.approx(1.0)
    untwisted = np.array(link.pose_of_line(target, away).matrix)
    twist = untwisted[:3, :3].T @ matrix[:3, :3]
    assert math.atan2(twist[1, 0], twist[0, 0]) == pytest.approx(turn, abs=1e-6)


def test_at_the_vertex_the_tools_y_is_anterior() -> None:
    matrix = np.array(link.pose_of_line([0.0, 0.0, 100.0], [0.0, 0.0, 150.0]).matrix)
    assert np.allclose(matrix[:3, :3], np.eye(3))


@pytest.mark.parametrize(
    "rotation", [np.diag([1.0, 1.0, -1.0]), np.diag([1.0, 1.0, 1.01]), np.full((3, 3), math.nan)], ids=str
)
def test_matrix_that_is_not_rigid_is_refused(rotation: Any) -> None:
    matrix = np.eye(4)
    matrix[:3, :3] = rotation
    with pytest.raises(link.PoseError):
        link.pose_of_matrix(matrix.tolist())


@pytest.mark.parametrize("value", [math.nan, math.inf])
def test_number_that_is_not_finite_is_not_sent(value: float) -> None:
    sent = link.Link(port=free_port(), pose_port=None, point_port=None)
    planner = link.Planner(sent)
    try:
        with pytest.raises(link.MessageError):
            planner.plan_landmarks([[0.0, 0.0, 0.0], [0.0, value, 0.0]])
        assert sent.under_way is None
        assert sent.counts.sent == 0
    finally:
        sent.close()


def test_every_button_is_a_command_of_the_daemon() -> None:
    for step in (*link.ACTIONS.values(), link.planner.HELLO):
        assert COMMANDS[step.name].payload == ()
    assert link.link.STOP in COMMANDS


@pytest.mark.parametrize(
    "outcome",
    [
        CommandOutcome("accepted", "gateway", "ready"),
        CommandOutcome("accepted", "placement", "placed", numbers=(0.1, -2.5e-5, 3.0)),
        CommandOutcome("rejected", "tool_plan", "not_yet", "residual_too_large"),
        CommandOutcome("failed", "placement", "held", "outcome_unknown"),
    ],
)
def test_verdicts_are_read_as_they_are_meant(outcome: CommandOutcome) -> None:
    number, verdict = link.messages.parse_verdict(outcome.reply("42").encode())
    assert number == 42
    assert (verdict.decision, verdict.branch, verdict.state) == (outcome.decision, outcome.branch, outcome.state)
    assert (verdict.reason, verdict.results) == (outcome.reason, outcome.numbers)


@given(st.binary(max_size=300))
def test_bytes_that_mean_nothing_are_dropped(data: bytes) -> None:
    for read in (link.messages.parse_verdict, link.messages.parse_stream, link.feed.parse_state):
        with pytest.raises((link.MessageError, link.PoseError)):
            read(data)


@given(st.binary(max_size=100))
def test_the_check_sum_is_that_of_openigtlink(data: bytes) -> None:
    assert link.feed.crc64(data) == CRC64(data)


def test_a_port_that_is_in_use_is_named() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
        other.bind(("127.0.0.1", 0))
        with pytest.raises(link.LinkError, match=str(other.getsockname()[1])):
            link.Link(pose_port=other.getsockname()[1], point_port=None)


def test_the_signer_is_the_one_to_copy() -> None:
    assert (MODULE / "pcmrs_link" / "signer.py").read_bytes() == (CLIENTS / "python" / "pcmrs_signer.py").read_bytes()


def test_the_core_needs_neither_slicer_nor_qt_nor_a_package() -> None:
    for file in (MODULE / "pcmrs_link").glob("*.py"):
        tree = ast.parse(file.read_text(encoding="utf-8"), feature_version=(3, 9))
        imports = [node for node in ast.walk(tree) if isinstance(node, ast.Import)]
        names = {alias.name for node in imports for alias in node.names}
        names |= {str(node.module) for node in ast.walk(tree) if isinstance(node, ast.ImportFrom) and not node.level}
        assert {name.partition(".")[0] for name in names} <= sys.stdlib_module_names, file


def test_the_module_compiles_for_the_python_of_slicer() -> None:
    source = (MODULE / "PcmrsPlanner.py").read_text(encoding="utf-8")
    compile(ast.parse(source, feature_version=(3, 9)), "PcmrsPlanner.py", "exec")


def test_everything_that_is_there_is_installed() -> None:
    listed = (MODULE / "CMakeLists.txt").read_text(encoding="utf-8")
    files = [file.relative_to(MODULE) for file in MODULE.rglob("*.py")]
    assert all(f"  {Path(file).as_posix()}\n" in listed for file in files)
