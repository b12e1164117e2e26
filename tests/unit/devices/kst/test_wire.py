"""Numbers and lines of the KST protocol, whatever is written and however a stream is cut."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pcmrs.devices.kst.wire import LONGEST, LineBuffer, parse_values, words
from pcmrs.errors import PayloadError

JAVA = {"1.0E-4": 1e-4, "-0.0": 0.0, "1.2345678901234567E10": 1.2345678901234567e10, "3.14159": 3.14159}


@pytest.mark.parametrize("text", list(JAVA))
def test_numbers_as_java_writes_them(text: str) -> None:
    assert parse_values(f"{text}_0.0_", 2).tolist() == [JAVA[text], 0.0]


NO_NUMBERS = [
    "NaN",
    "Infinity",
    "-Infinity",
    "nan",
    "inf",
    "1e-4",
    "1.0e-4",
    "1",
    ".5",
    "1.",
    "+1.0",
    "1.0E999",
    "1.0E",
]


@pytest.mark.parametrize("text", [*NO_NUMBERS, "1.0\r", "0x1.0p3", "1,0", " 1.0", ""])
def test_other_numbers_are_refused(text: str) -> None:
    with pytest.raises(PayloadError):
        parse_values(f"{text}_0.0_", 2)


@pytest.mark.parametrize("count", [0, 1, 3])
def test_a_wrong_count_is_refused(count: int) -> None:
    with pytest.raises(PayloadError, match="not 2 numbers"):
        parse_values("1.0_" * count, 2)


@given(st.lists(st.floats(-1e4, 1e4), min_size=1, max_size=7))
def test_written_values_are_within_half_of_the_last_decimal(values: list[float]) -> None:
    assert np.allclose(parse_values(words(values), len(values)), values, rtol=0.0, atol=5.001e-6)


MESSAGES = st.lists(st.text(st.characters(min_codepoint=0x20, max_codepoint=0x7E), max_size=60), max_size=12)


@given(MESSAGES, st.lists(st.integers(0, 800), max_size=30))
def test_any_splitting_and_merging_gives_the_same_messages(messages: list[str], cuts: list[int]) -> None:
    data = "".join(f"{message}\n" for message in messages).encode()
    places = sorted({0, len(data), *(min(cut, len(data)) for cut in cuts)})
    buffer = LineBuffer()
    heard = [line for begin, end in pairwise(places) for line in buffer.feed(data[begin:end])]
    assert heard == messages


@given(st.binary(max_size=200), st.integers(1, 50))
def test_garbage_is_split_into_text_or_refused(data: bytes, chunk: int) -> None:
    buffer = LineBuffer()
    try:
        for start in range(0, len(data), chunk):
            for line in buffer.feed(data[start : start + chunk]):
                assert line.isprintable()
    except PayloadError:
        return
    assert all(0x20 <= byte < 0x7F or byte == 0x0A for byte in data)


def test_a_line_without_end_is_refused_soon() -> None:
    buffer = LineBuffer()
    buffer.feed(b"0" * LONGEST)
    with pytest.raises(PayloadError, match="without an end"):
        buffer.feed(b"0")
