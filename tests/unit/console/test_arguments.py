"""What a person types becomes arguments in SI units; an invalid value is found at its field."""

from __future__ import annotations

import math
from typing import Any

import pytest

from pcmrs.console._arguments import (
    FieldError,
    can_be_typed,
    default_text,
    given,
    label_with_unit,
    limits_text,
    refused_field,
    value_of,
)
from pcmrs.messages.setup import ArgumentShown
from tests.unit.console.detached_page import ENGLISH


def argument(**given: Any) -> ArgumentShown:
    fields: dict[str, Any] = {"name": "it", "kind": "number", "required": True}
    return ArgumentShown(**fields | given)


@pytest.mark.parametrize(
    ("fields", "typed", "value"),
    [
        ({}, " 2.5 ", 2.5),
        ({}, "2,5", 2.5),
        ({"unit": "m"}, "5", 0.005),
        ({"unit": "rad"}, "180", math.pi),
        ({"kind": "integer"}, "3", 3),
        ({"kind": "numbers", "count": 3, "unit": "m"}, "1 -2 0,5", [0.001, -0.002, 0.0005]),
        ({"kind": "text"}, " Dr Hand ", "Dr Hand"),
        ({"kind": "yes_no"}, "True", True),
        ({"kind": "yes_no"}, "False", False),
        ({"kind": "choice", "choices": ["ml", "staircase"]}, "ml", "ml"),
        ({"required": False, "default": 4.0}, "", 4.0),
        ({"required": False, "optional": True}, "", None),
    ],
)
def test_a_value_is_read_in_the_unit_that_people_use(fields: dict[str, Any], typed: str, value: object) -> None:
    assert value_of(argument(**fields), typed, ENGLISH) == pytest.approx(value)


@pytest.mark.parametrize(
    ("fields", "typed", "text"),
    [
        ({}, "", ENGLISH("field_needed")),
        ({}, "much", ENGLISH("field_number")),
        ({}, "1 2", ENGLISH("field_number")),
        ({}, "inf", ENGLISH("field_number")),
        ({"kind": "integer"}, "2.5", ENGLISH("field_integer")),
        ({"kind": "numbers", "count": 3}, "1 2", ENGLISH("field_numbers", count=3)),
        ({"unit": "N", "least": 1.0, "most": 5.0}, "7", "From 1 N to 5 N."),
        ({"unit": "m", "above": 0.0}, "0", "At least 0 mm."),
        ({"unit": "m", "below": 0.07}, "70", "At most 70 mm."),
        ({"kind": "choice", "choices": ["ml"]}, "mm", ENGLISH("field_choice", choices="ml")),
        ({"kind": "text", "longest": 3}, "long", ENGLISH("field_longest", most=3)),
    ],
)
def test_an_invalid_value_says_the_limit(fields: dict[str, Any], typed: str, text: str) -> None:
    with pytest.raises(FieldError) as refused:
        value_of(argument(**fields), typed, ENGLISH)
    assert refused.value.text == text


def test_a_field_shows_unit_default_and_limits() -> None:
    spacing = argument(name="grid_spacing", unit="m", default=0.01, required=False, least=0.002, most=0.05)
    assert label_with_unit(spacing) == "Grid spacing, mm"
    assert default_text(spacing) == "10"
    assert limits_text(spacing, ENGLISH) == "From 2 mm to 50 mm."
    turned = argument(kind="numbers", count=3, unit="rad", default=[0.0, 0.0, math.pi])
    assert default_text(turned) == "0 0 180"
    assert (label_with_unit(argument()), default_text(argument()), limits_text(argument(), ENGLISH)) == ("It", "", "")


def test_only_what_differs_from_its_default_is_sent() -> None:
    asked = [argument(name="a"), argument(name="b", required=False, default=1.0), argument(name="c", required=False)]
    assert given({"a": 1.0, "b": 1.0, "c": 2.0}, asked) == {"a": 1.0, "c": 2.0}
    assert given({"a": 1.0, "b": 3.0, "c": None}, asked) == {"a": 1.0, "b": 3.0}


def test_a_refusal_of_the_daemon_is_shown_at_its_field() -> None:
    asked = [argument(name="percent")]
    text = "stimulation.set_ceiling: Expected `float` <= 100.0 - at `$.percent`."
    assert refused_field(text, asked) == ("percent", "stimulation.set_ceiling: Expected `float` <= 100.0.")
    assert refused_field("It is latched.", asked) == ("", "It is latched.")
    assert refused_field("Wrong - at `$.other`.", asked) == ("", "Wrong - at `$.other`.")


def test_a_form_cannot_ask_for_what_needs_a_surface() -> None:
    assert not can_be_typed([argument(kind="other")])
    assert can_be_typed([argument(kind="other", required=False), argument()])
