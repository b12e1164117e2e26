"""Reads the streamed answer of a chat completion: server-sent events, each with a piece of the text."""

from __future__ import annotations

from collections.abc import AsyncIterable, AsyncIterator
from dataclasses import dataclass
from typing import Any

import msgspec

LONGEST_LINE = 1_000_000
"""Limit of one event, bytes."""
DONE = b"[DONE]"
CHARACTERS_PER_TOKEN = 4
"""Typical length of a token, for servers that count none."""


class BrokenStreamError(Exception):
    """The stream ended before the answer did: another attempt may succeed."""


class ForeignStreamError(Exception):
    """What arrives is not of this interface."""


class _Delta(msgspec.Struct):
    content: str | None = None
    refusal: str | None = None


class _Choice(msgspec.Struct):
    delta: _Delta = msgspec.field(default_factory=_Delta)
    finish_reason: str | None = None


class _Usage(msgspec.Struct):
    prompt_tokens: int = 0
    completion_tokens: int = 0


class _Chunk(msgspec.Struct):
    choices: list[_Choice] = []
    usage: _Usage | None = None
    error: Any = None


@dataclass(frozen=True, slots=True)
class StreamedAnswer:
    """One answer.

    Attributes:
        text: Its text.
        complete: The model has ended it; false if it was cut at the limit of tokens.
        refusal: Reason why the model refuses; empty if it does not.
        request_tokens: Tokens of the request, as the server counts them; None if it does not.
        answer_tokens: Tokens of the answer, as the server counts them, or else estimated.
    """

    text: str
    complete: bool
    refusal: str
    request_tokens: int | None
    answer_tokens: int


class AnswerReader:
    """Collector of the pieces of one answer.

    Attributes:
        pieces: Number of events so far; each holds a token or more.

    Args:
        limit: Limit of the answer, tokens: a server may ignore the limit that it was given.
    """

    def __init__(self, limit: int) -> None:
        self.pieces = 0
        self._limit = limit
        self._characters = 0
        self._texts: list[str] = []
        self._refusals: list[str] = []
        self._finish = ""
        self._usage: _Usage | None = None

    async def read(self, stream: AsyncIterable[bytes]) -> StreamedAnswer:
        """Read events until the answer ends.

        Args:
            stream: Body of the response.

        Raises:
            BrokenStreamError: It ends too early, or the server reports a failure in it.
            ForeignStreamError: An event is not of this interface.
        """
        async for event in _events(stream):
            if event == DONE:
                break
            self._take(event)
            if self._over:
                self._finish = "length"
                break
        if not self._finish:
            raise BrokenStreamError("the connection ended before the answer did")
        refusal = "".join(self._refusals)
        if self._finish == "content_filter" and not refusal:
            refusal = "the server's filter has stopped the answer"
        usage = self._usage
        return StreamedAnswer(
            text="".join(self._texts),
            complete=self._finish == "stop",
            refusal=refusal,
            request_tokens=None if usage is None else usage.prompt_tokens,
            answer_tokens=self.tokens if usage is None else usage.completion_tokens,
        )

    @property
    def tokens(self) -> int:
        """Estimated tokens so far."""
        return max(self.pieces, self._characters // CHARACTERS_PER_TOKEN)

    @property
    def _over(self) -> bool:
        return self.pieces > 2 * self._limit or self._characters > 2 * CHARACTERS_PER_TOKEN * self._limit

    def _take(self, event: bytes) -> None:
        try:
            chunk = msgspec.json.decode(event, type=_Chunk)
        except msgspec.DecodeError as error:
            raise ForeignStreamError(f"an event is not of this interface: {error}") from None
        if chunk.error is not None:
            raise BrokenStreamError(f"the server reports {str(chunk.error)[:200]}")
        self.pieces += 1
        self._usage = chunk.usage or self._usage
        for choice in chunk.choices[:1]:
            text, refusal = choice.delta.content or "", choice.delta.refusal or ""
            self._texts.append(text)
            self._refusals.append(refusal)
            self._characters += len(text) + len(refusal)
            self._finish = choice.finish_reason or self._finish


async def _events(stream: AsyncIterable[bytes]) -> AsyncIterator[bytes]:
    """Return the data of each event. Comments, with which servers keep a connection open, are left out."""
    rest = b""
    async for piece in stream:
        *lines, rest = (rest + piece).split(b"\n")
        if len(rest) > LONGEST_LINE:
            raise ForeignStreamError(f"a line has over {LONGEST_LINE} bytes")
        for line in lines:
            if line.startswith(b"data:"):
                yield line.removeprefix(b"data:").strip()
