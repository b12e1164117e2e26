"""Clipping of what a sender has chosen."""

from __future__ import annotations

from typing import Any

import msgspec
from hypothesis import given
from hypothesis import strategies as st

from pcmrs.messages import Reason
from pcmrs.messages.clipping import (
    BEGINNING,
    CLIPPED,
    LONGEST,
    LONGEST_FIELDS,
    LONGEST_TEXT,
    clipped,
    clipped_reason,
    shortened,
)


def test_short_arguments_are_kept_and_of_long_ones_the_hash() -> None:
    short, long = {"text": "x"}, {"text": "x" * LONGEST}
    assert clipped(short) == short
    kept = clipped(long)
    assert set(kept) == {CLIPPED}
    assert kept[CLIPPED]["bytes"] > LONGEST
    assert clipped({"text": "x" * (LONGEST - 1) + "y"})[CLIPPED]["sha256"] != kept[CLIPPED]["sha256"]
    assert clipped(kept) == kept


@given(st.dictionaries(st.text(), st.text() | st.floats(allow_nan=False) | st.lists(st.integers())))
def test_clipped_arguments_never_exceed_the_limit(arguments: dict[str, Any]) -> None:
    whole = msgspec.json.encode(arguments, order="sorted")
    for stored in (clipped(arguments), clipped(arguments | {"padding": "x" * LONGEST})):
        assert len(msgspec.json.encode(stored)) <= LONGEST
    assert (clipped(arguments) is arguments) == (len(whole) <= LONGEST)


def test_a_reason_of_usual_length_is_unchanged() -> None:
    reason = Reason(code="busy", text="x" * LONGEST_TEXT, fields={"known": ["plan", "clear"]})
    assert clipped_reason(reason) is reason


@given(st.text(max_size=20), st.integers(0, 3 * LONGEST_TEXT), st.integers(0, 3 * LONGEST_FIELDS))
def test_a_reason_takes_little_whatever_it_repeats(name: str, text: int, fields: int) -> None:
    reason = clipped_reason(Reason(code="busy", text=name + "x" * text, fields={"names": [name, "x" * fields]}))
    assert reason.text.startswith(name)
    assert len(reason.text) <= LONGEST_TEXT + 30
    assert len(msgspec.json.encode(reason.fields)) <= LONGEST_FIELDS
    assert clipped_reason(Reason(code="busy", text="", fields=reason.fields)).fields == reason.fields


def test_a_long_text_is_its_beginning_and_its_length() -> None:
    assert shortened("abc", 3) == "abc"
    assert shortened("abcd", 3) == "abc… (4 characters)"
    assert shortened("ä" * BEGINNING, 1) == f"ä… ({BEGINNING} characters)"
