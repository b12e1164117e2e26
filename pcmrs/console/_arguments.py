"""Arguments of an operation as a person types them, in units that people use. Pure."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from typing import Any, Final

from pcmrs.console.texts import Texts
from pcmrs.messages.setup import ArgumentShown

UNITS: Final = {"m": ("mm", 1000.0), "rad": ("°", math.degrees(1.0)), "percent": ("%", 1.0), "deg": ("°", 1.0)}
"""Unit of an argument to the unit that people use, and the factor to it."""
_FIELD = re.compile(r"\$\.(\w+)")
_AT = re.compile(r" - at `\$\.\w+[^`]*`")


class FieldError(Exception):
    """A field does not hold a valid value; never leaves the console.

    Attributes:
        text: What is wrong, and the limit.
    """

    def __init__(self, text: str) -> None:
        super().__init__(text)
        self.text = text


def can_be_typed(arguments: Sequence[ArgumentShown]) -> bool:
    """Return true if a form can ask for all arguments that have no default."""
    return all(each.kind != "other" or not each.required for each in arguments)


def label_with_unit(argument: ArgumentShown) -> str:
    """Return the label of a field: its name, and its unit if it has one."""
    unit = UNITS.get(argument.unit, (argument.unit, 1.0))[0]
    name = argument.name.replace("_", " ").capitalize()
    return f"{name}, {unit}" if unit else name


def default_text(argument: ArgumentShown) -> str:
    """Return the text that a field begins with: its default, in the unit that people use."""
    value = argument.default
    if value is None:
        return ""
    if isinstance(value, bool | str):
        return str(value)
    factor = UNITS.get(argument.unit, ("", 1.0))[1]
    numbers = value if isinstance(value, list | tuple) else [value]
    return " ".join(f"{factor * float(each):g}" for each in numbers)


def limits_text(argument: ArgumentShown, texts: Texts) -> str:
    """Return the limits of a number in the unit that people use; empty if there are none.

    Args:
        argument: The argument.
        texts: Texts in the language of the page.
    """
    unit, factor = UNITS.get(argument.unit, (argument.unit, 1.0))
    low, high = _lowest(argument), _highest(argument)
    shown = {"least": _number(low, factor, unit), "most": _number(high, factor, unit)}
    if low is not None and high is not None:
        return texts("limits_both", **shown)
    if low is not None:
        return texts("limit_least", **shown)
    return "" if high is None else texts("limit_most", **shown)


def value_of(argument: ArgumentShown, typed: str, texts: Texts) -> Any:
    """Return the value of an argument from what a person has typed; None if the field may be left empty and is.

    Args:
        argument: The argument.
        typed: Content of its field.
        texts: Texts in the language of the page.

    Raises:
        FieldError: It is not a valid value.
    """
    text = typed.strip()
    if not text:
        if argument.required and not argument.optional:
            raise FieldError(texts("field_needed"))
        return argument.default
    match argument.kind:
        case "number":
            return _checked(argument, _numbers(text, 1, texts)[0], texts)
        case "integer":
            number = _numbers(text, 1, texts)[0]
            if number != int(number):
                raise FieldError(texts("field_integer"))
            return int(_checked(argument, number, texts))
        case "numbers":
            return [each / _factor(argument) for each in _numbers(text, argument.count, texts)]
        case "yes_no":
            return text == "True"
        case "choice" if text not in argument.choices:
            raise FieldError(texts("field_choice", choices=", ".join(argument.choices)))
        case "text" if argument.longest is not None and len(text) > argument.longest:
            raise FieldError(texts("field_longest", most=argument.longest))
        case _:
            return text


def refused_field(text: str, arguments: Sequence[ArgumentShown]) -> tuple[str, str]:
    """Return the field that the daemon's refusal is about, and what it says; no field if it is about none.

    Args:
        text: Reason of the refusal.
        arguments: Arguments of the form.
    """
    found = _FIELD.search(text)
    name = found[1] if found is not None and found[1] in {each.name for each in arguments} else ""
    return name, _AT.sub("", text) if name else text


def given(values: Mapping[str, Any], arguments: Sequence[ArgumentShown]) -> dict[str, Any]:
    """Return the values to send: those that differ from their defaults, and all that are required.

    Args:
        values: Value of each argument.
        arguments: Arguments of the form.
    """
    return {
        each.name: values[each.name]
        for each in arguments
        if each.name in values and (each.required or values[each.name] != each.default)
    }


def _factor(argument: ArgumentShown) -> float:
    return UNITS.get(argument.unit, ("", 1.0))[1]


def _numbers(text: str, count: int, texts: Texts) -> list[float]:
    # A comma is a decimal comma in many languages; numbers are separated by spaces.
    words = text.replace(",", ".").split()
    try:
        found = [float(each) for each in words]
    except ValueError:
        found = []
    if len(found) != count or not all(map(math.isfinite, found)):
        raise FieldError(texts("field_numbers", count=count) if count > 1 else texts("field_number"))
    return found


def _lowest(argument: ArgumentShown) -> float | None:
    return argument.least if argument.least is not None else argument.above


def _highest(argument: ArgumentShown) -> float | None:
    return argument.most if argument.most is not None else argument.below


def _number(value: float | None, factor: float, unit: str) -> str:
    return "" if value is None else f"{factor * value:g} {unit}".strip()


def _checked(argument: ArgumentShown, typed: float, texts: Texts) -> float:
    """Return a number in the argument's own unit, within its limits."""
    value = typed / _factor(argument)
    too_low = (argument.least is not None and value < argument.least) or (
        argument.above is not None and value <= argument.above
    )
    too_high = (argument.most is not None and value > argument.most) or (
        argument.below is not None and value >= argument.below
    )
    if too_low or too_high:
        raise FieldError(limits_text(argument, texts))
    return value
