"""Forms get kind, unit, limits, choices, default and help of each argument from its type."""

from __future__ import annotations

from typing import Annotated, Literal

import msgspec
import pytest

from pcmrs.dispatcher.arguments import arguments_shown
from pcmrs.messages.setup import ArgumentShown
from tests.support.shipped import NAMES, shipped_workflow


class Given(msgspec.Struct, frozen=True):
    """Arguments of something.

    Attributes:
        force: Force along the tool's axis,
            N; None for the configured one.
        translation: Translation, m.
        count: Number of points.
        name: Name of the person.
        method: Method.
        sure: True if a person has looked.
        plan: A nested plan.
        visits: The patient's visits until now.
        file: Base name of the surface's file; None for the configured one.
        group: Group, N or S.
    """

    translation: tuple[float, float, float]
    plan: dict[str, float]
    name: Annotated[str, msgspec.Meta(max_length=100)]
    force: Annotated[float, msgspec.Meta(gt=0.0, le=5.0)] | None = None
    count: Annotated[int, msgspec.Meta(ge=1, le=100)] = 1
    method: Literal["ml", "staircase"] = "ml"
    sure: bool = False
    visits: int = 1
    file: str | None = None
    group: Literal["N", "S"] = "N"


def test_each_kind_of_argument_is_described() -> None:
    found = {each.name: each for each in arguments_shown({"given": Given})["given"]}
    assert list(found) == list(Given.__struct_fields__)
    assert found["force"] == ArgumentShown(
        name="force", kind="number", help="Force along the tool's axis, N; None for the configured one.", unit="N",
        optional=True, above=0.0, most=5.0,
    )  # fmt: skip
    assert (found["translation"].kind, found["translation"].count, found["translation"].unit) == ("numbers", 3, "m")
    assert found["translation"].required
    assert (found["count"].kind, found["count"].default, found["count"].least) == ("integer", 1, 1)
    assert (found["name"].kind, found["name"].longest, found["name"].unit) == ("text", 100, "")
    assert (found["method"].kind, found["method"].choices) == ("choice", ["ml", "staircase"])
    assert (found["sure"].kind, found["sure"].default) == ("yes_no", False)
    assert found["plan"].kind == "other"


@pytest.mark.parametrize("name", ["visits", "file", "group"])
def test_a_letter_that_is_no_unit_is_not_shown_as_one(name: str) -> None:
    (found,) = (each for each in arguments_shown({"given": Given})["given"] if each.name == name)
    assert found.unit == ""


@pytest.mark.parametrize("name", NAMES)
def test_arguments_of_shipped_workflows_can_be_sent_with_help(name: str) -> None:
    workflow = shipped_workflow(name)
    shown = arguments_shown(workflow.registry.payloads)
    assert msgspec.json.decode(msgspec.json.encode(shown), type=dict[str, list[ArgumentShown]]) == shown
    for branch in workflow.blueprint.branches.values():
        for spec in branch.operations.values():
            assert all(each.help for each in shown[spec.payload]), spec.payload
            assert not any(each.unit for each in shown[spec.payload] if each.kind == "text"), spec.payload
    assert [each.unit for each in shown["nudge"]] == ["m", "rad"]
