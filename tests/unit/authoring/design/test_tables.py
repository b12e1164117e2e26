"""A step table as its experts write it: what is declared, and what is inherited."""

from __future__ import annotations

import msgspec
import pytest

from pcmrs.authoring.design.tables import DECLARATIONS, ActionSpec, StepSpec


@pytest.mark.parametrize("key", DECLARATIONS)
def test_one_key_declares_the_effect_even_if_it_is_false(key: str) -> None:
    assert not ActionSpec(operation="drill").declared
    assert msgspec.convert({"operation": "drill", key: False}, ActionSpec).declared


def test_an_operation_that_takes_back_has_the_roles_of_its_step() -> None:
    own = ActionSpec(operation="withdraw", roles=["viewer"])
    step = StepSpec(name="placed", operation="place", roles=["operator"], reopened_by=["clear", own])
    assert step.reopeners() == [ActionSpec(operation="clear", roles=["operator"]), own]


def test_a_step_without_title_is_called_by_its_name() -> None:
    assert StepSpec(name="needle_aligned", operation="align").meaning == "needle aligned"
    assert StepSpec(name="needle_aligned", operation="align", title="Needle at the entry").meaning == (
        "Needle at the entry"
    )


@pytest.mark.parametrize(
    ("key", "value"), [("moves", "sideways"), ("roles", ["nobody"]), ("colour", "red"), ("depends_on", "a")]
)
def test_a_value_that_means_nothing_is_refused(key: str, value: object) -> None:
    with pytest.raises(msgspec.ValidationError, match=key):
        msgspec.convert({"name": "a", "operation": "do_a", key: value}, StepSpec)
