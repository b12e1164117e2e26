"""Names of journals in an archive, and the order of their segments."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pcmrs.archive._segment import JournalName, Segment, follow_segments
from pcmrs.errors import AlteredSegmentError, ArchiveError, DoubledSegmentError, MissingSegmentError
from pcmrs.journal.rows import START, RowPosition

NAME = JournalName.of("lab", "cell1", "ratms", bytes(range(32)))


def at(sequence: int) -> RowPosition:
    return RowPosition(sequence, sequence.to_bytes(32, "big")) if sequence else START


def segments(*bounds: tuple[int, int]) -> list[Segment]:
    return [Segment(NAME, at(start), at(end)) for start, end in bounds]


def test_a_name_says_cell_workflow_and_first_row() -> None:
    assert str(NAME) == "lab/cell1/ratms-0001020304050607"


@pytest.mark.parametrize("part", ["", "..", "a/b", ".hidden", "a b", "x" * 64, "a\0"])
def test_no_name_leads_out_of_the_archive(part: str) -> None:
    for names in ((part, "cell1", "ratms"), ("lab", part, "ratms"), ("lab", "cell1", part)):
        with pytest.raises(ArchiveError, match="--cell SITE/NAME"):
            JournalName.of(*names, bytes(32))


@given(st.lists(st.integers(1, 50), max_size=5))
def test_segments_in_order_end_with_the_last_row(sizes: list[int]) -> None:
    ends = [sum(sizes[: number + 1]) for number in range(len(sizes))]
    assert follow_segments(NAME, segments(*zip([0, *ends], ends, strict=False))) == at(sum(sizes))


@pytest.mark.parametrize(
    ("bounds", "error", "first", "last"),
    [
        (((10, 20),), MissingSegmentError, 1, 10),
        (((0, 10), (15, 20)), MissingSegmentError, 11, 15),
        (((0, 10), (5, 20)), DoubledSegmentError, 6, 10),
    ],
)
def test_a_gap_or_an_overlap_is_named(
    bounds: tuple[tuple[int, int], ...], error: type[ArchiveError], first: int, last: int
) -> None:
    with pytest.raises(error, match=f"Rows {first}–{last} of lab/cell1/ratms") as raised:
        follow_segments(NAME, segments(*bounds))
    assert raised.value.fields | {"cell": "lab/cell1", "first": first, "last": last} == raised.value.fields
    assert "Put it back from a copy" in raised.value.text


def test_a_segment_of_another_chain_is_altered() -> None:
    other = Segment(NAME, RowPosition(10, bytes(32)), at(20))
    with pytest.raises(AlteredSegmentError, match="do not follow from the row before them"):
        follow_segments(NAME, [*segments((0, 10)), other])
