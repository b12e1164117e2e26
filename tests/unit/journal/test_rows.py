"""Rows survive their encoding, and what is no row is an error."""

from __future__ import annotations

from typing import Any

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pcmrs.errors import JournalError
from pcmrs.journal.rows import decode_row, encode_row
from tests.unit.journal.journal_rows import row

plain = st.recursive(
    st.none() | st.booleans() | st.integers(-(2**63), 2**63 - 1) | st.floats(allow_nan=False) | st.text(),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(), inner, max_size=3),
    max_leaves=8,
)


@given(st.permutations(["a", "b", "c", "d"]))
def test_the_encoding_does_not_depend_on_the_order_of_keys(keys: list[str]) -> None:
    mixed = row(arguments={key: dict.fromkeys(keys, 1) for key in keys})
    ordered = row(arguments={key: dict.fromkeys(sorted(keys), 1) for key in sorted(keys)})
    assert encode_row(mixed) == encode_row(ordered)


@given(st.dictionaries(st.text(), plain, max_size=3))
def test_rows_survive_their_encoding(arguments: dict[str, object]) -> None:
    original = row(arguments=arguments, states={"robot": "1"})
    assert decode_row(encode_row(original)) == original


def test_damaged_row_is_an_error() -> None:
    with pytest.raises(JournalError, match="damaged"):
        decode_row(msgspec.msgpack.encode({"kind": "intent"}))
    deep = encode_row(row(arguments={"a": "x"})).replace(b"\xa1x", b"\x91" * 100_000)
    with pytest.raises(JournalError, match="damaged"):
        decode_row(deep)


@pytest.mark.parametrize(
    "fields",
    [
        {"wall": 1e300},
        {"wall": -1e11},
        {"wall": float("nan")},
        {"arguments": {"a": msgspec.msgpack.Ext(5, b"x")}},
        {"arguments": {"a": {1: 2}}},
        {"result": {"a": {None: 1}}},
    ],
)
def test_a_row_that_no_journal_of_ours_holds_is_damaged(fields: dict[str, Any]) -> None:
    """Found by `fuzz.journals`: exports and reports of such a row ended with an `OverflowError` or a `TypeError`."""
    foreign = msgspec.to_builtins(row()) | fields
    with pytest.raises(JournalError, match="damaged"):
        decode_row(msgspec.msgpack.encode(foreign))


@pytest.mark.parametrize(
    "value",
    ["\ud800", 2**70, -(2**70), object(), {1: {2: object()}}],
    ids=["surrogate", "large", "small", "object", "nested object"],
)
def test_value_that_a_row_cannot_hold_is_refused(value: object) -> None:
    with pytest.raises(JournalError, match="cannot be journalled"):
        encode_row(row(result={"value": value}))


def test_value_that_contains_itself_is_refused() -> None:
    endless: list[object] = []
    endless.append(endless)
    with pytest.raises(JournalError, match="cannot be journalled"):
        encode_row(row(result={"value": endless}))
