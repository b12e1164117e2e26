"""The arguments of operations as forms show them: kind, unit, limits, choices, default and help of each."""

from __future__ import annotations

import inspect
import re
from collections.abc import Mapping
from typing import Any

import msgspec
from msgspec import inspect as types

from pcmrs.messages.setup import ArgumentShown

_ATTRIBUTE = re.compile(r"^    (\w+): ", re.MULTILINE)
_UNIT = re.compile(r"(?<!['’])\b(m|mm|rad|deg|s|N|Hz|percent)\b(?=[^,]*?(?:[.;]|$))")
_WITH_UNIT = ("number", "integer", "numbers")


def arguments_shown(payloads: Mapping[str, type[msgspec.Struct]]) -> dict[str, list[ArgumentShown]]:
    """Return the arguments of each registered type, in their order.

    Args:
        payloads: Registered name to the type of the arguments.
    """
    return {name: _fields(kind) for name, kind in payloads.items()}


def _fields(kind: type[msgspec.Struct]) -> list[ArgumentShown]:
    described = types.type_info(kind)
    if not isinstance(described, types.StructType):
        return []
    helps = _helps(kind)
    return [_shown(field, helps.get(field.encode_name, "")) for field in described.fields]


def _helps(kind: type[msgspec.Struct]) -> dict[str, str]:
    """Return what the docstring of a type says about each of its fields."""
    _, _, text = inspect.cleandoc(kind.__doc__ or "").partition("Attributes:\n")
    _, *parts = _ATTRIBUTE.split(text)
    return {name: " ".join(words.split()) for name, words in zip(parts[::2], parts[1::2], strict=True)}


def _shown(field: types.Field, text: str) -> ArgumentShown:
    possible = field.type.types if isinstance(field.type, types.UnionType) else (field.type,)
    kinds = [each for each in possible if not isinstance(each, types.NoneType)]
    limits = _limits(kinds[0] if len(kinds) == 1 else field.type)
    unit = _UNIT.search(text) if limits["kind"] in _WITH_UNIT else None
    default = field.default_factory() if field.default_factory is not msgspec.NODEFAULT else field.default
    return ArgumentShown(
        name=field.encode_name,
        help=text,
        unit=unit[1] if unit is not None else "",
        required=field.required,
        optional=len(kinds) < len(possible),
        default=None if field.required else msgspec.json.decode(msgspec.json.encode(default)),
        **limits,
    )


def _limits(kind: types.Type) -> dict[str, Any]:
    """Return the kind of a type, with its limits; ``other`` for one that no field can show."""
    match kind:
        case types.BoolType():
            return {"kind": "yes_no"}
        case types.IntType() | types.FloatType():
            name = "integer" if isinstance(kind, types.IntType) else "number"
            return {"kind": name, "least": kind.ge, "most": kind.le, "above": kind.gt, "below": kind.lt}
        case types.StrType():
            return {"kind": "text", "longest": kind.max_length}
        case types.LiteralType():
            return {"kind": "choice", "choices": [str(each) for each in kind.values]}
        case types.TupleType() if all(isinstance(each, types.FloatType) for each in kind.item_types):
            return {"kind": "numbers", "count": len(kind.item_types)}
        case _:
            return {"kind": "other"}
