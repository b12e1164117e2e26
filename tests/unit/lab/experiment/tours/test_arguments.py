"""Arguments of a tour: every operation of a workflow gets some, in turn, of its plan or of a file."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

from pcmrs.errors import ConfigurationError
from pcmrs.spatial import Transform
from pcmrs.testing.plan import example_plan, read_plan
from pcmrs.workflows import find_workflow
from pcmrs_lab.experiment.tours.arguments import NUDGES, PRESSES, TourArguments, plan_arguments, read_arguments
from tests.unit.lab.blueprints import ratms

PLAN = read_plan(example_plan("ratms"))


def test_arguments_are_used_in_turn_from_the_first_one_on() -> None:
    """The first nudge leads away from the body, the second one back."""
    arguments = TourArguments(plan_arguments(PLAN))
    turns = [arguments.next("placement.nudge", "nudge") for _ in range(4)]
    assert turns == [*NUDGES, *NUDGES]
    indices = [arguments.next("digitization.digitize_one", "landmark_index")["index"] for _ in PLAN.landmarks]
    assert indices == list(range(len(PLAN.landmarks)))
    other = arguments.next("digitization.redigitize_one", "landmark_index")
    assert other == {"index": 0}, "each operation has its own turn"


def test_arguments_of_operation_count_before_its_payloads() -> None:
    arguments = TourArguments({"press": PRESSES, "placement.press": {"force": 3.0}})
    assert [arguments.next("placement.press", "press") for _ in range(2)] == [{"force": 3.0}] * 2
    assert arguments.next("other.press", "press") == PRESSES[0]
    assert arguments.next("other.connect", "none") == {}


def test_the_example_plan_has_arguments_for_every_operation() -> None:
    arguments = TourArguments(plan_arguments(PLAN))
    assert arguments.missing(ratms()) == {}
    choices = arguments.choices(ratms())
    assert choices["digitization.digitize_one"] == len(PLAN.landmarks)
    assert choices["robot.connect"] == 1


@pytest.mark.parametrize(("workflow", "without"), [("femoroplasty", set()), ("grid_mapping", {"grid"})])
def test_other_workflows_have_arguments_for_their_payloads(workflow: str, without: set[str]) -> None:
    """Their files are read as tables: checking a whole blueprint takes seconds."""
    branches = tomllib.loads(find_workflow(workflow).blueprint.read_text())["branches"].values()
    payloads = {spec["payload"] for branch in branches for spec in branch["operations"].values() if "payload" in spec}
    assert payloads - plan_arguments(PLAN).keys() - {"none"} == without


def test_operations_without_arguments_named_with_their_payload() -> None:
    given = plan_arguments(PLAN)
    del given["nudge"]
    arguments = TourArguments(given | {"press": []})
    assert arguments.missing(ratms()) == {"placement.nudge": "nudge", "placement.press": "press"}
    assert arguments.next("placement.nudge", "nudge") == {}


def test_a_trajectory_leads_from_the_planned_pose_into_the_body() -> None:
    trajectory: Any = plan_arguments(PLAN)["trajectory"]
    pose = PLAN.poses[0]
    entry, target = np.array(trajectory["entry"]), np.array(trajectory["target"])
    tool_from_image = Transform.from_quat_xyzw(pose.position, pose.quat_xyzw).inverse()
    assert tool_from_image @ entry == pytest.approx(np.zeros(3), abs=1e-12)
    assert tool_from_image @ target == pytest.approx(np.array([0.0, 0.0, -0.03]))


def test_a_file_names_operations_and_payloads(tmp_path: Path) -> None:
    file = tmp_path / "arguments.toml"
    file.write_text('nudge = [{ translation = [0.0, 0.0, 0.002] }]\n["placement.press"]\nforce = 2.0\n')
    assert read_arguments(file) == {"nudge": [{"translation": [0.0, 0.0, 0.002]}], "placement.press": {"force": 2.0}}


@pytest.mark.parametrize("text", ["[", "nudge = 1", 'nudge = ["x"]', "\ud800", "a = " + "[" * 3_000])
def test_a_file_that_is_no_table_of_arguments_is_refused(tmp_path: Path, text: str) -> None:
    file = tmp_path / "arguments.toml"
    file.write_bytes(text.encode(errors="surrogatepass"))
    with pytest.raises(ConfigurationError, match="contains no valid arguments"):
        read_arguments(file)


def test_a_missing_file_is_refused_with_the_reason(tmp_path: Path) -> None:
    with pytest.raises(ConfigurationError, match=r"none\.toml cannot be read: No such file"):
        read_arguments(tmp_path / "none.toml")


def test_arguments_are_plain_data_as_in_a_file() -> None:
    assert msgspec.json.decode(msgspec.json.encode(plan_arguments(PLAN)))["tool_pose"].keys() == {
        "position",
        "quat_xyzw",
    }
