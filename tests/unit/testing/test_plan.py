"""Plan files: the examples, and files that are no plan."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

from pcmrs.errors import ConfigurationError
from pcmrs.testing.plan import Plan, example_plan, read_plan

EXAMPLES = ("ratms", "femoroplasty")


@pytest.mark.parametrize("workflow", EXAMPLES)
def test_example_plans_register_a_body_and_place_a_tool(workflow: str) -> None:
    plan = read_plan(example_plan(workflow))
    names = [landmark.name for landmark in plan.landmarks]
    assert len(set(names)) == len(names) >= 3
    assert plan.poses
    places = np.array([landmark.position for landmark in plan.landmarks])
    spread = np.linalg.svd(places - places.mean(axis=0), compute_uv=False)
    assert spread[1] > 0.01, "they do not lie on a line, m"
    assert np.abs(places).max() < 1.0, "they are in m"


@pytest.mark.parametrize("workflow", EXAMPLES)
def test_a_plan_that_is_written_reads_back(workflow: str, tmp_path: Path) -> None:
    plan = read_plan(example_plan(workflow))
    file = tmp_path / "plan.json"
    file.write_bytes(msgspec.json.encode(plan))
    assert read_plan(file) == plan


def test_a_missing_file_is_named() -> None:
    assert example_plan("none") == Path("examples/none_plan.json")
    with pytest.raises(ConfigurationError, match=r"none_plan\.json cannot be read: No such file") as error:
        read_plan(example_plan("none"))
    assert error.value.fields["file"] == "examples/none_plan.json"


@pytest.mark.parametrize(
    "change",
    [{"landmarks": None}, {"poses": {}}, {"tool": 1}, {"landmarks": [{"name": "nasion"}]}, {"poses": [{"x": 1.0}]}],
)
def test_a_file_that_is_no_plan_is_refused(change: dict[str, Any], tmp_path: Path) -> None:
    fields: dict[str, Any] = msgspec.to_builtins(read_plan(example_plan("ratms")))
    msgspec.convert(fields, Plan)
    file = tmp_path / "plan.json"
    for content in (msgspec.json.encode(fields | change), b"", b"[" * 10_000, b"\xff"):
        file.write_bytes(content)
        with pytest.raises(ConfigurationError, match="is not a plan"):
            read_plan(file)
