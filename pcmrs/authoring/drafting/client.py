"""Client of a language model: one streamed chat completion per question, with limits, and attempts with pauses."""

from __future__ import annotations

from collections.abc import AsyncIterator, Callable, Sequence
from contextlib import asynccontextmanager
from itertools import count
from typing import Any

import httpx
import msgspec

from pcmrs.authoring.drafting._stream import (
    CHARACTERS_PER_TOKEN,
    AnswerReader,
    BrokenStreamError,
    ForeignStreamError,
    StreamedAnswer,
)
from pcmrs.authoring.drafting.model import ModelError, ModelSettings
from pcmrs.clock import Clock

Message = dict[str, str]

TEMPORARY = frozenset({408, 409, 425, 429, 500, 502, 503, 504, 529})
"""Statuses after which another attempt may succeed."""
LONGEST_PAUSE = 60.0
"""Limit of the pause between attempts, s, also if the server asks for more."""
SHOWN = 300
"""Length of a server's message in ours, characters."""


class _TemporaryError(Exception):
    """An attempt has failed, but another may succeed."""

    def __init__(self, text: str, wait: float = 0.0) -> None:
        super().__init__(text)
        self.wait = wait


class ModelClient:
    """Client of one model that counts its tokens. Create it with `ModelClient.open`.

    Attributes:
        request_tokens: Tokens of all requests so far.
        answer_tokens: Tokens of all answers so far.

    Args:
        settings: The model and the limits.
        http: Connections to its server.
        clock: Clock of the machine.
        report: Called with a line about each attempt that has failed.
    """

    def __init__(
        self, settings: ModelSettings, http: httpx.AsyncClient, clock: Clock, report: Callable[[str], object]
    ) -> None:
        self.settings = settings
        self.request_tokens = 0
        self.answer_tokens = 0
        self._http = http
        self._clock = clock
        self._report = report

    @classmethod
    @asynccontextmanager
    async def open(
        cls, settings: ModelSettings, key: str, clock: Clock, report: Callable[[str], object]
    ) -> AsyncIterator[ModelClient]:
        """Open the client of a model; nothing is sent yet.

        Args:
            settings: The model and the limits.
            key: Key of the interface; empty for none.
            clock: Clock of the machine.
            report: Called with a line about each attempt that has failed.

        Raises:
            ConfigurationError: Address or model are missing or not possible.
        """
        settings.check(key)
        limits = httpx.Timeout(settings.idle_s, connect=settings.connect_s)
        headers = {"Authorization": f"Bearer {key}"} if key else {}
        # Neither redirections nor a proxy of the environment: the key and the text are for this address only.
        async with httpx.AsyncClient(timeout=limits, headers=headers, follow_redirects=False, trust_env=False) as http:
            yield cls(settings, http, clock, report)

    @property
    def cost(self) -> float:
        """Cost so far, in the currency of the prices."""
        return self.settings.cost(self.request_tokens, self.answer_tokens)

    async def ask(self, messages: Sequence[Message], schema: dict[str, Any]) -> StreamedAnswer:
        """Return the answer to a conversation.

        Args:
            messages: The conversation.
            schema: JSON Schema that the answer is to follow.

        Raises:
            ModelError: There is no answer after all attempts, or a limit is reached, or the model refuses.
        """
        settings = self.settings
        for attempt in count(1):
            self._check_limits(messages)
            try:
                answer = await self._attempt(messages, schema)
            except _TemporaryError as error:
                if attempt == settings.attempts:
                    text = f"{settings.url} gives no answer after {attempt} attempts: {error}."
                    raise ModelError(text, why="unreachable", attempts=attempt) from None
                pause = min(max(error.wait, settings.backoff_s * 2.0 ** (attempt - 1)), LONGEST_PAUSE)
                self._report(f"Attempt {attempt} of {settings.attempts}: {error}. The next one is in {pause:g} s.")
                await self._clock.sleep(pause)
            else:
                break
        if answer.refusal:
            raise ModelError(f"{settings.model} refuses: {answer.refusal[:SHOWN]}", why="refused")
        return answer

    def _check_limits(self, messages: Sequence[Message]) -> None:
        """Refuse a question whose answer could exceed a limit.

        Raises:
            ModelError: It could.
        """
        settings = self.settings
        requested = self.request_tokens + _estimated(messages)
        answered = self.answer_tokens + settings.answer_tokens
        if requested + answered > settings.total_tokens:
            text = f"The next answer could exceed total_tokens = {settings.total_tokens}: "
            text += f"{self.request_tokens + self.answer_tokens} are used."
            raise ModelError(text, why="limit", limit=settings.total_tokens)
        if settings.total_cost and settings.cost(requested, answered) > settings.total_cost:
            text = f"The next answer could exceed total_cost = {settings.total_cost:g}: {self.cost:g} is spent."
            raise ModelError(text, why="limit", limit=settings.total_cost)

    async def _attempt(self, messages: Sequence[Message], schema: dict[str, Any]) -> StreamedAnswer:
        reader = AnswerReader(self.settings.answer_tokens)
        counted: StreamedAnswer | None = None
        try:
            async with self._clock.timeout(self.settings.answer_s):
                counted = await self._streamed(reader, self._body(messages, schema))
        except TimeoutError:
            raise _TemporaryError(f"the answer takes over {self.settings.answer_s:g} s") from None
        except httpx.TimeoutException:
            raise _TemporaryError("the server is silent for too long") from None
        except (httpx.TransportError, BrokenStreamError) as error:
            raise _TemporaryError(str(error) or type(error).__name__) from None
        except ForeignStreamError as error:
            text = f"{self.settings.url} is not the interface that is expected: {error}."
            raise ModelError(text, why="malformed") from None
        finally:
            self._count(messages, reader, counted)
        return counted

    def _count(self, messages: Sequence[Message], reader: AnswerReader, counted: StreamedAnswer | None) -> None:
        """Add the tokens of an attempt; an answer that broke off costs, too."""
        # A server that reports nothing, or less than that, must not lift the limits.
        asked, answered = (0, 0) if counted is None else (counted.request_tokens or 0, counted.answer_tokens)
        self.request_tokens += asked if asked > 0 else _estimated(messages)
        self.answer_tokens += answered if answered > 0 else reader.tokens

    async def _streamed(self, reader: AnswerReader, body: bytes) -> StreamedAnswer:
        url = f"{self.settings.url.rstrip('/')}/chat/completions"
        headers = {"Content-Type": "application/json", "Accept": "text/event-stream"}
        async with self._http.stream("POST", url, content=body, headers=headers) as response:
            if response.status_code in TEMPORARY:
                wait = response.headers.get("Retry-After", "")
                text = f"the server answers {response.status_code}: {await _beginning(response)}"
                raise _TemporaryError(text, float(wait) if wait.isdecimal() else 0.0)
            if response.status_code != httpx.codes.OK:
                text = f"{url} answers {response.status_code}: {await _beginning(response)}"
                raise ModelError(text, why="http", status=response.status_code)
            return await reader.read(response.aiter_bytes())

    def _body(self, messages: Sequence[Message], schema: dict[str, Any]) -> bytes:
        settings = self.settings
        body: dict[str, Any] = {
            "model": settings.model,
            "messages": list(messages),
            "stream": True,
            "stream_options": {"include_usage": True},
            "response_format": {
                "type": "json_schema",
                "json_schema": {"name": "step_table", "strict": True, "schema": schema},
            },
            settings.limit_key: settings.answer_tokens,
        }
        if settings.temperature is not None:
            body["temperature"] = settings.temperature
        return msgspec.json.encode(body)


async def _beginning(response: httpx.Response) -> str:
    """Return the first part of a message, on one line."""
    text = b""
    async for piece in response.aiter_bytes():
        text += piece
        if len(text) > SHOWN:
            break
    return " ".join(text[:SHOWN].decode(errors="replace").split())


def _estimated(messages: Sequence[Message]) -> int:
    return sum(len(message["content"]) for message in messages) // CHARACTERS_PER_TOKEN
