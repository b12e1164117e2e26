"""The C# client by itself: the mirror between hands, the messages it reads, and the package around it."""

from __future__ import annotations

import json
import os
import re
import socket
import time
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from pcmrs.gateway.grammar import CommandOutcome
from pcmrs.gateway.openigtlink._streams import state_json
from pcmrs.gateway.streams import point_message, pose_message, unity_message
from pcmrs.messages import Snapshot
from pcmrs.messages._snapshot import BlueprintTag
from pcmrs.spatial import Transform
from tests.system.clients.unity_programs import (
    NEEDS_MONO,
    PACKAGE,
    SWAP,
    Probe,
    from_numbers,
    mirrored,
    mirrored_numbers,
    pose_numbers,
    running_probe,
)

pytestmark = NEEDS_MONO

_points = st.tuples(*[st.floats(-1.0, 1.0)] * 3)
_rotvecs = st.tuples(*[st.floats(-3.2, 3.2)] * 3)
_poses = st.builds(Transform.from_rotvec, _points, _rotvecs)


@pytest.fixture(scope="module")
def probe(programs: Path) -> Iterator[Probe]:
    with running_probe(programs) as running:
        yield running


def matrix(pose: Transform) -> np.ndarray[Any, Any]:
    return np.vstack([np.column_stack([pose.rotation, pose.translation]), [0.0, 0.0, 0.0, 1.0]])


def same(found: Transform, expected: Transform, metres: float = 1e-12, radians: float = 1e-7) -> None:
    np.testing.assert_allclose(found.translation, expected.translation, atol=metres)
    assert (Rotation.from_matrix(found.rotation).inv() * Rotation.from_matrix(expected.rotation)).magnitude() < radians


# The mirror -----------------------------------------------------------------------------------------------------------


@given(_poses, _points)
def test_poses_points_and_matrices_are_mirrored_alike(probe: Probe, pose: Transform, point: tuple[float, ...]) -> None:
    found = from_numbers(probe.numbers("mirror_pose", *pose_numbers(pose)))
    same(found, mirrored(pose))
    whole = probe.numbers("mirror_matrix", *matrix(pose).ravel()).reshape(4, 4)
    np.testing.assert_allclose(whole, matrix(mirrored(pose)), atol=1e-12)
    # A point that moves with a body is where the mirrored body takes the mirrored point.
    there = probe.numbers("apply", *mirrored_numbers(pose), *(SWAP @ point))
    np.testing.assert_allclose(there, SWAP @ (pose @ np.array(point)), atol=1e-12)
    np.testing.assert_allclose(probe.numbers("mirror_point", *point), SWAP @ point, atol=1e-15)


@given(_poses, _points)
def test_the_mirror_of_the_mirror_is_what_was_there(probe: Probe, pose: Transform, point: tuple[float, ...]) -> None:
    once = probe.numbers("mirror_pose", *pose_numbers(pose))
    np.testing.assert_allclose(probe.numbers("mirror_pose", *once), pose_numbers(pose), atol=1e-15)
    np.testing.assert_allclose(probe.numbers("mirror_point", *probe.numbers("mirror_point", *point)), point, atol=1e-15)
    twice = probe.numbers("mirror_matrix", *probe.numbers("mirror_matrix", *matrix(pose).ravel()))
    np.testing.assert_allclose(twice, matrix(pose).ravel(), atol=1e-15)


@given(_poses, _poses)
def test_the_mirror_of_a_product_is_the_product_of_the_mirrors(
    probe: Probe, first: Transform, second: Transform
) -> None:
    product = from_numbers(probe.numbers("compose", *mirrored_numbers(first), *mirrored_numbers(second)))
    same(product, mirrored(first @ second))
    inverse = from_numbers(probe.numbers("inverse", *mirrored_numbers(first)))
    same(inverse, mirrored(first.inverse()))


RIGHT, ANTERIOR, SUPERIOR = np.eye(3)
UNITY_RIGHT, UNITY_UP, UNITY_FORWARD = np.eye(3)


def test_anatomical_axes_become_those_of_a_standing_person(probe: Probe) -> None:
    for axis, seen in ((RIGHT, UNITY_RIGHT), (ANTERIOR, UNITY_FORWARD), (SUPERIOR, UNITY_UP)):
        np.testing.assert_array_equal(probe.numbers("mirror_point", *axis), seen)


@pytest.mark.parametrize(
    ("axis", "turned", "becomes"),
    [(RIGHT, ANTERIOR, SUPERIOR), (ANTERIOR, SUPERIOR, RIGHT), (SUPERIOR, RIGHT, ANTERIOR)],
)
def test_quarter_turn_about_each_axis_keeps_the_sides(
    probe: Probe, axis: np.ndarray[Any, Any], turned: np.ndarray[Any, Any], becomes: np.ndarray[Any, Any]
) -> None:
    turn = Transform.from_rotvec((0.0, 0.0, 0.0), tuple(axis * np.pi / 2.0))
    np.testing.assert_allclose(turn @ turned, becomes, atol=1e-12)
    seen = probe.numbers("mirror_pose", *pose_numbers(turn))
    np.testing.assert_allclose(probe.numbers("apply", *seen, *(SWAP @ turned)), SWAP @ becomes, atol=1e-12)


@given(_poses)
def test_a_basis_changes_its_hand_and_a_rotation_stays_one(probe: Probe, pose: Transform) -> None:
    seen = [probe.numbers("mirror_point", *(pose.rotation @ axis)) for axis in np.eye(3)]
    assert np.linalg.det(seen) == pytest.approx(-1.0)
    turned = probe.numbers("mirror_matrix", *matrix(pose).ravel()).reshape(4, 4)
    assert np.linalg.det(turned) == pytest.approx(1.0)


@given(_poses)
@example(Transform.from_rotvec((0.0, 0.0, 0.0), (np.pi, 0.0, 0.0)))
@example(Transform.from_rotvec((0.0, 0.0, 0.0), (0.0, np.pi, 0.0)))
@example(Transform.from_rotvec((0.0, 0.0, 0.0), (0.0, 0.0, np.pi)))
@example(Transform.from_rotvec((0.0, 0.0, 0.0), (0.0, 2.2, 2.2)))
def test_matrices_and_quaternions_say_the_same(probe: Probe, pose: Transform) -> None:
    np.testing.assert_allclose(probe.numbers("to_matrix", *pose_numbers(pose)), matrix(pose).ravel(), atol=1e-12)
    same(from_numbers(probe.numbers("from_matrix", *matrix(pose).ravel())), pose)


@pytest.mark.parametrize("spoilt", [np.diag([1.0, 1.0, -1.0, 1.0]), np.diag([1.1, 1.1, 1.1, 1.0]), np.zeros((4, 4))])
def test_invalid_rotation_is_refused(probe: Probe, spoilt: np.ndarray[Any, Any]) -> None:
    assert probe.ask("from_matrix", *spoilt.ravel())["error"] == "FormatException"


# What the daemon sends ------------------------------------------------------------------------------------------------


@given(_poses)
def test_every_stream_of_a_pose_means_the_same_pose(probe: Probe, pose: Transform) -> None:
    sent = {prefix: unity_message(prefix, pose) for prefix in ("crnt_", "trgt_", "regi_")}
    sent["__msg_pose_"] = pose_message(pose)
    kinds = ["Tool", "Target", "Registration", "VisualizedTool"]
    for text, kind in zip(sent.values(), kinds, strict=True):
        answer = probe.ask(f"message {text}")
        assert answer["text"] == kind
        same(from_numbers(answer["numbers"]), mirrored(pose), metres=1e-7, radians=1e-4)


@given(_points, _points)
def test_streams_of_points_are_mirrored_and_in_metres(
    probe: Probe, first: tuple[float, ...], second: tuple[float, ...]
) -> None:
    tip = probe.ask(f"message {point_message(np.array(first))}")
    assert tip["text"] == "PointerTip"
    np.testing.assert_allclose(tip["numbers"], SWAP @ first, atol=1e-8)
    both = "_".join(f"{1e3 * number:.5f}" for number in (*first, *second))
    relayed = probe.ask(f"message __msg_toolpose_{both}")
    assert relayed["text"] == "ToolPoints"
    np.testing.assert_allclose(relayed["numbers"], [*(SWAP @ first), *(SWAP @ second)], atol=1e-8)


@pytest.mark.parametrize(
    "text",
    [
        "",
        "crnt_",
        "crnt_1_2_3_0_0_0",
        "crnt_1_2_3_0_0_0_1_0",
        "crnt_1_2_3_0_0_0_1;",
        "crnt_1_2_3_0_0_0_nan",
        "crnt_1_2_Infinity_0_0_0_1",
        "crnt_1_2_1e999_0_0_0_1",
        "crnt_1_2_ 3_0_0_0_1",
        "crnt_1_2_3,5_0_0_0_1",
        "crnt_1_2_3_0_0_0_0",
        "crnt_1_2_3_0_0_0_2",
        "CRNT_1_2_3_0_0_0_1",
        "__msg_point_1_2",
        "__msg_toolpose_1_2_3_4_5",
        "ack",
    ],
)
def test_incomplete_message_is_refused(probe: Probe, text: str) -> None:
    assert probe.ask(f"message {text}")["error"] == "FormatException"


@given(
    st.integers(0, 10**10 - 1),
    st.sampled_from(["accepted", "rejected", "failed"]),
    st.from_regex(r"[a-z][a-z_]{0,8}", fullmatch=True),
    st.lists(st.floats(-1e3, 1e3), max_size=9),
)
def test_verdict_replies_are_read(probe: Probe, number: int, decision: Any, word: str, results: list[float]) -> None:
    accepted = decision == "accepted"
    outcome = CommandOutcome(decision, word, "111", None if accepted else word, tuple(results) if accepted else ())
    answer = probe.ask(f"verdict {outcome.reply(str(number))}")
    branch = word.replace("_", "-")
    assert answer["text"] == f"{number} {decision.capitalize()} {branch} 111 {'' if accepted else word}"
    np.testing.assert_allclose(answer["numbers"], results if accepted else [], rtol=1e-5)


@pytest.mark.parametrize("reply", ["ack", "1_accepted_a", "1_maybe_a_b;", "1_accepted_a_b_x;"])
def test_invalid_verdict_is_refused(probe: Probe, reply: str) -> None:
    assert probe.ask(f"verdict {reply}")["error"] == "FormatException"


_words = st.text(max_size=8).filter(lambda text: text.isprintable())


@example({'\\ " / é': "1"}, "\\u", False)
@given(st.dictionaries(_words, st.from_regex(r"[01]{1,3}|\w{1,6}", fullmatch=True), max_size=4), _words, st.booleans())
def test_any_state_is_read(probe: Probe, branches: dict[str, str], plan: str, latched: bool) -> None:
    flags = dict.fromkeys(branches, latched)
    tag = BlueprintTag(id="ratms", version="1", hash="0")
    shown = Snapshot(
        sequence=2**40, branches=branches, flags=flags, running=[], latched=latched, blueprint=tag, plan=plan
    )
    answer = probe.ask(f"state_of {state_json(shown)}")
    assert (answer["branches"], answer["flags"]) == (branches, flags)
    assert (answer["sequence"], answer["latched"], answer["plan"]) == (2**40, latched, plan)
    assert answer["registration"] is None


@pytest.mark.parametrize("text", ["", "{}", "[1]", '{"sequence": "1"}', "{" * 100, '{"a": tru}', '{"a": "\\u00zz"}'])
def test_invalid_state_is_refused(probe: Probe, text: str) -> None:
    assert probe.ask(f"state_of {text}")["error"] == "FormatException"


def test_a_country_with_decimal_commas_reads_and_writes_the_same(programs: Path) -> None:
    with running_probe(programs, {**os.environ, "LC_ALL": "de_DE.UTF-8"}) as probe:
        answer = probe.ask("message crnt_0.5_-1.25_3e-1_0_0_0_1")
        assert answer["numbers"] == [0.5, -1.25, 0.3, 0.0, 0.0, 0.0, 1.0]


# What the receiver keeps ----------------------------------------------------------------------------------------------


def test_of_a_burst_the_newest_is_kept_and_strangers_are_refused(programs: Path) -> None:
    with running_probe(programs) as probe, _sender("127.0.0.1") as daemon, _sender("127.0.0.2") as stranger:
        port = int(probe.numbers("receive 0")[0])
        assert probe.ask("newest Tool")["numbers"] is None
        for number in range(200):
            daemon.sendto(b"crnt_%d_0_0_0_0_0_1" % number, ("127.0.0.1", port))
        daemon.sendto(b"trgt_7_0_0_0_0_0_1", ("127.0.0.1", port))
        stranger.sendto(b"crnt_666_0_0_0_0_0_1", ("127.0.0.1", port))
        daemon.sendto(b"crnt_666_0_0_0_0_0", ("127.0.0.1", port))
        daemon.sendto(b"crnt_666_0_0_0_0_0_1." + b"0" * 600, ("127.0.0.1", port))
        end = time.monotonic() + 5.0
        while probe.numbers("received")[0] < 204 and time.monotonic() < end:
            pass
        np.testing.assert_array_equal(probe.numbers("received"), [204, 3])
        assert probe.numbers("newest Tool")[0] == 199
        assert probe.numbers("newest Target")[0] == 7
        assert probe.ask("newest Registration")["numbers"] is None


def test_old_pose_is_not_shown(programs: Path) -> None:
    with running_probe(programs) as probe, _sender("127.0.0.1") as daemon:
        port = int(probe.numbers("receive 0")[0])
        daemon.sendto(b"crnt_1_0_0_0_0_0_1", ("127.0.0.1", port))
        end, sent = time.monotonic() + 5.0, time.monotonic()
        while probe.ask("newest Tool")["numbers"] is None:
            assert time.monotonic() < end
        while probe.ask("newest Tool")["numbers"] is not None:
            assert time.monotonic() < end
        assert time.monotonic() - sent > 0.95


def _sender(host: str) -> socket.socket:
    sender = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    sender.bind((host, 0))
    return sender


# The package ----------------------------------------------------------------------------------------------------------


def test_every_asset_has_its_own_identity() -> None:
    """Without it, Unity ignores the files of a package that is not in the project itself."""
    assets = [file for file in PACKAGE.rglob("*") if "Tests~" not in file.parts and file.suffix != ".meta"]
    assert len(assets) > 15
    metas = [file.with_name(file.name + ".meta").read_text(encoding="ascii") for file in assets]
    found = [re.fullmatch(r"fileFormatVersion: 2\nguid: ([0-9a-f]{32})\n", meta) for meta in metas]
    identities = sorted(match[1] for match in found if match is not None)
    assert len(identities) == len(assets)
    assert all(first != second for first, second in pairwise(identities))
    assert {meta.with_suffix("") for meta in PACKAGE.rglob("*.meta")} == set(assets)


def test_core_knows_nothing_of_unity() -> None:
    core, layer = (PACKAGE / "Runtime" / name for name in ("Core/Pcmrs.Core.asmdef", "Unity/Pcmrs.Unity.asmdef"))
    assert json.loads(core.read_text(encoding="ascii"))["noEngineReferences"] is True
    assert json.loads(layer.read_text(encoding="ascii"))["references"] == ["Pcmrs.Core"]
