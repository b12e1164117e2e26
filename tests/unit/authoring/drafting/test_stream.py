"""Server-sent events in pieces of any size."""

from __future__ import annotations

from collections.abc import AsyncIterator

import pytest

from pcmrs.authoring.drafting._stream import LONGEST_LINE, AnswerReader, BrokenStreamError, ForeignStreamError

EVENTS = (
    b': ping\r\n\r\ndata: {"choices":[{"delta":{"content":"\xc3\xa4b"},"finish_reason":null}]}\r\n\r\n'
    b'event: message\ndata:{"choices":[{"delta":{"content":"c","reasoning_content":"r"},"finish_reason":"stop"}]}\n\n'
    b'data: {"choices":[],"usage":{"prompt_tokens":3,"completion_tokens":2}}\n\ndata: [DONE]\n\n'
)


async def pieces(data: bytes, size: int) -> AsyncIterator[bytes]:
    for start in range(0, len(data), size):
        yield data[start : start + size]


@pytest.mark.parametrize("size", [1, 7, 1000])
async def test_events_are_read_in_pieces_of_any_size(size: int) -> None:
    answer = await AnswerReader(100).read(pieces(EVENTS, size))
    assert (answer.text, answer.complete, answer.refusal) == ("äbc", True, "")
    assert (answer.request_tokens, answer.answer_tokens) == (3, 2)


async def test_an_answer_without_end_is_broken() -> None:
    with pytest.raises(BrokenStreamError, match="before the answer did"):
        await AnswerReader(100).read(pieces(EVENTS[:100], 10))
    with pytest.raises(BrokenStreamError, match="out of memory"):
        await AnswerReader(100).read(pieces(b'data: {"error": {"message": "out of memory"}}\n', 10))


@pytest.mark.parametrize(
    "data", [b"data: <html>\n", b'data: {"choices": 1}\n', b"data: \xff\n", b"x" * LONGEST_LINE * 2]
)
async def test_events_of_another_kind_are_foreign(data: bytes) -> None:
    with pytest.raises(ForeignStreamError):
        await AnswerReader(100).read(pieces(data, 100_000))


async def test_thoughts_without_text_are_limited_too() -> None:
    thought = b'data: {"choices":[{"delta":{"reasoning_content":"hm"}}]}\n'
    answer = await AnswerReader(10).read(pieces(thought * 1000, 64))
    assert (answer.text, answer.complete, answer.answer_tokens) == ("", False, 21)
