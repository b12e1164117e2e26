"""Encoding in one step of messages with a closed type, such as poses, joints and beats: no field is `Any`.

All others are first turned into plain data, because they may hold values that only MessagePack or only JSON knows. The
types here hold none, so that `msgspec` writes the same bytes at once, in a fraction of the time.
"""

from __future__ import annotations

import functools
from typing import Any, Final

import msgspec
from msgspec import inspect

_PLAIN: Final = (inspect.FloatType, inspect.IntType, inspect.StrType, inspect.BoolType, inspect.NoneType)

encode_closed: Final = msgspec.msgpack.Encoder().encode
"""Encodes a message of a closed type. Raises `TypeError`, `ValueError` or `OverflowError`."""


@functools.cache
def is_closed(kind: type[Any]) -> bool:
    """Return True if all parts of a type are numbers, text, truth values, None, and lists and structs of those."""
    return _is_plain(inspect.type_info(kind))


def _is_plain(info: inspect.Type) -> bool:
    match info:
        case inspect.StructType(fields=fields):
            return all(_is_plain(field.type) for field in fields)
        case inspect.TupleType(item_types=types) | inspect.UnionType(types=types):
            return all(map(_is_plain, types))
        case inspect.ListType(item_type=item) | inspect.VarTupleType(item_type=item):
            return _is_plain(item)
        case inspect.LiteralType(values=values):
            return all(isinstance(value, str) for value in values)
        case _:
            return isinstance(info, _PLAIN)
