"""Poses, frames and schemas as Foxglove can show them."""

from __future__ import annotations

import json
import math
from pathlib import Path

import jsonschema
import pytest
from foxglove.messages import LogLevel

from pcmrs.messages import BlueprintTag, DeviceHealth, Epoch, Message, Snapshot
from pcmrs.messages.health import Health
from pcmrs.messages.setup import LandmarkShown, ProcedureDataView, StimulationShown
from pcmrs.recording._foxglove_messages import FoxgloveView, joints, json_bytes, json_schema, line, link, pose_in
from pcmrs.service.health.report import report
from pcmrs.spatial import Transform
from tests.support.health_facts import WELL
from tests.unit.recording.recording_bench import read_back


@pytest.mark.parametrize("kind", [Snapshot, ProcedureDataView, Epoch, Health, DeviceHealth])
def test_message_schema_has_no_word_that_foxglove_refuses(kind: type[Message]) -> None:
    """As its reader of JSON schemas does, packages/mcap-support/src/parseJsonSchema.ts of Foxglove Studio 1."""
    schemas = [json_schema(kind)]
    assert schemas[0]["properties"].keys() == set(kind.__struct_fields__)
    while schemas:
        schema = schemas.pop()
        assert schema["type"] == "object"
        for field in schema["properties"].values():
            shape = field["items"] if field["type"] == "array" else field
            assert shape["type"] in ("boolean", "string", "number", "integer", "object"), field
            schemas += [shape] if shape["type"] == "object" else []


TAG = BlueprintTag(id="ratms", version="1", hash="0")
EMPTY = (
    Snapshot(sequence=1, branches={"robot": "0"}, flags={}, running=[], latched=False, blueprint=TAG),
    ProcedureDataView(
        landmarks=[LandmarkShown(name="nasion", planned=(0.0, 0.1, 0.2))],
        residual=math.nan,
        stimulation=StimulationShown(response={"mep": None}),
    ),
    report(WELL),
)


@pytest.mark.parametrize("message", EMPTY, ids=lambda message: type(message).__name__)
def test_a_message_without_values_fits_its_own_schema(message: Message) -> None:
    shown = json.loads(json_bytes(message))
    jsonschema.validate(shown, json_schema(type(message)))
    assert None not in shown.values()


@pytest.mark.parametrize("at_ns", [0, 1, 999_999_999, 10**18 + 7])
def test_a_time_keeps_its_nanoseconds(at_ns: int, tmp_path: Path) -> None:
    (_, shown) = read_back([("/log", line(LogLevel.Warning, "robot", "It moves.", at_ns))], tmp_path / "run.mcap")[0]
    assert (shown.timestamp.seconds, shown.timestamp.nanos) == divmod(at_ns, 10**9)
    assert (shown.name, shown.message, shown.level) == ("robot", "It moves.", 3)


def test_time_before_1970_is_recorded_as_0(tmp_path: Path) -> None:
    """A machine without a set clock begins at 0, and a pose is older than its message."""
    (_, shown) = read_back([("/log", line(LogLevel.Info, "robot", "It moves.", -1))], tmp_path / "run.mcap")[0]
    assert (shown.timestamp.seconds, shown.timestamp.nanos) == (0, 0)


def test_link_and_pose_hold_the_transform(tmp_path: Path) -> None:
    """The order of a quaternion differs: ours is w x y z."""
    pose = Transform.from_rotvec((0.1, -0.2, 0.3), (0.4, -0.5, 0.6))
    views: list[tuple[str, FoxgloveView]] = [
        ("/tf", link("tracker", "coil", pose, 5)),
        ("/pose", pose_in("image", pose, 5)),
    ]
    (_, links), (_, placed) = read_back(views, tmp_path / "run.mcap")
    (joined,) = links.transforms
    assert (joined.parent_frame_id, joined.child_frame_id, placed.frame_id) == ("tracker", "coil", "image")
    for place, turn in (
        (joined.translation, joined.rotation),
        (placed.pose.position, placed.pose.orientation),
    ):
        again = Transform.from_quat_xyzw((place.x, place.y, place.z), (turn.x, turn.y, turn.z, turn.w))
        assert again.matrix == pytest.approx(pose.matrix, abs=1e-12)


def test_every_joint_has_its_name_and_its_values(tmp_path: Path) -> None:
    ((_, shown),) = read_back([("/joints", joints(["a", "b"], [0.1, 0.2], [0.3, 0.4], 5))], tmp_path / "run.mcap")
    assert [(each.name, each.position, each.velocity) for each in shown.joints] == [("a", 0.1, 0.3), ("b", 0.2, 0.4)]
    with pytest.raises(ValueError, match="shorter"):
        joints(["a", "b"], [0.1], [0.3, 0.4], 5)
