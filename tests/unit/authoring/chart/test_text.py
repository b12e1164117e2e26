"""Texts of a chart: whatever a workflow says fits its line, its width and XML."""

from __future__ import annotations

import itertools
from xml.etree import ElementTree
from xml.sax.saxutils import escape

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from pcmrs.authoring.chart._text import clean, cut, flow, inner_lines, mono_width, sans_width, wrap
from tests.unit.fsm.arm_workflow import arm_blueprint

WORDS = st.lists(st.text("abcxyz_", min_size=1, max_size=40), max_size=12)


@given(st.text())
@example("\x00 \x1f a\r\nb\t\u2028 \ufffe \ud800 ]]> <")
def test_any_text_is_one_line_that_xml_holds(text: str) -> None:
    cleaned = clean(text)
    read = ElementTree.fromstring(f"<t>{escape(cleaned)}</t>".encode())
    assert (read.text or "") == cleaned
    assert len(cleaned.splitlines()) <= 1
    assert clean(cleaned) == cleaned


@given(WORDS, st.integers(3, 30))
def test_words_flow_in_order_and_never_beyond_the_line(words: list[str], columns: int) -> None:
    lines = flow(words, columns)
    assert all(len(line) <= columns for line in lines)
    assert " ".join(lines).split() == [cut(word, columns) for word in words]
    # No line could have taken the first word of the next.
    for line, following in itertools.pairwise(lines):
        assert len(line) + 1 + len(following.split()[0]) > columns


def test_a_piece_longer_than_a_line_is_broken_at_its_spaces() -> None:
    assert flow(["approach: well (RIO),", "stop"], 14) == ["approach: well", "(RIO), stop"]


@given(st.text("ab ", max_size=60), st.integers(2, 30), st.integers(1, 3))
def test_what_is_cut_ends_with_an_ellipsis(text: str, columns: int, lines: int) -> None:
    assert len(cut(text, columns)) <= columns
    assert cut(text, columns).endswith("…") == (len(text) > columns)
    assert len(wrap(text, columns, lines)) <= lines


@pytest.mark.parametrize("width", [mono_width, sans_width])
@given(one=st.text(max_size=10), other=st.text(max_size=10), size=st.integers(5, 30))
def test_widths_add_up_and_grow_with_the_font(width: type, one: str, other: str, size: int) -> None:
    assert width(one + other, size) == pytest.approx(width(one, size) + width(other, size))
    assert width(one, 2 * size) == pytest.approx(2 * width(one, size))


def test_wide_characters_take_two_columns() -> None:
    assert mono_width("頭部", 10) == pytest.approx(mono_width("head", 10))
    assert sans_width("頭", 10) > sans_width("h", 10)


def test_only_a_state_with_an_activity_has_a_line_about_it() -> None:
    arm = arm_blueprint().branches["arm"]
    assert inner_lines(arm, "following") == ["do / follow_head"]
    assert inner_lines(arm, "away") == []
