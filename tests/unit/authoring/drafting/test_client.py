"""The client of a model, against a server that speaks the real protocol over HTTP."""

from __future__ import annotations

from typing import Any

import pytest

from pcmrs.authoring.drafting.model import ModelError
from pcmrs.errors import ConfigurationError
from tests.unit.authoring.drafting.made_answers import asking
from tests.unit.authoring.drafting.model_server import (
    Reply,
    answering,
    breaking,
    ending_early,
    endless,
    failing,
    foreign,
    refusing,
    reporting_failure,
    served,
    silent,
    trickling,
)

MESSAGES = [{"role": "user", "content": "A question of forty characters, to a model."}]


async def test_an_answer_is_joined_from_its_pieces() -> None:
    with served(answering("größer " * 30)) as server:
        async with asking(server.url, key="secret", temperature=0.0) as asked:
            answer = await asked.client.ask(MESSAGES, {"type": "object"})
    assert (answer.text, answer.complete) == ("größer " * 30, True)
    assert (asked.client.request_tokens, asked.client.answer_tokens) == (100, 50)
    (request,) = server.requests
    assert (request["path"], request["key"]) == ("/v1/chat/completions", "Bearer secret")
    assert (request["model"], request["stream"], request["max_tokens"]) == ("made", True, 16_000)
    assert request["response_format"]["json_schema"]["schema"] == {"type": "object"}
    assert (request["messages"], request["temperature"]) == (MESSAGES, 0.0)


async def test_without_a_key_none_is_sent() -> None:
    with served(answering("yes")) as server:
        async with asking(server.url, limit_key="max_completion_tokens") as asked:
            await asked.client.ask(MESSAGES, {})
    assert server.requests[0]["key"] is None
    assert server.requests[0]["max_completion_tokens"] == 16_000
    assert "max_tokens" not in server.requests[0]
    assert "temperature" not in server.requests[0]


@pytest.mark.parametrize(
    "reply",
    [breaking, ending_early, reporting_failure, failing(503), failing(429)],
    ids=["breaks", "ends early", "reports a failure", "503", "429"],
)
async def test_a_failed_attempt_is_repeated(reply: Reply) -> None:
    with served(reply, reply, answering("yes")) as server:
        async with asking(server.url, backoff_s=2.0) as asked:
            answer = await asked.client.ask(MESSAGES, {})
    assert answer.text == "yes"
    assert asked.clock.pauses == [2.0, 4.0]
    assert [line.partition(":")[0] for line in asked.lines] == ["Attempt 1 of 4", "Attempt 2 of 4"]


async def test_the_server_may_ask_for_a_longer_pause() -> None:
    with served(failing(429, Retry_After="7"), failing(429, Retry_After="9999"), answering("yes")) as server:
        async with asking(server.url) as asked:
            await asked.client.ask(MESSAGES, {})
    assert asked.clock.pauses == [7.0, 60.0]


@pytest.mark.parametrize(
    ("reply", "limits", "why"),
    [(silent, {"idle_s": 0.05}, "silent for too long"), (trickling, {"answer_s": 0.05}, "takes over 0.05 s")],
)
async def test_a_server_that_sends_no_answer_is_left(reply: Reply, limits: dict[str, Any], why: str) -> None:
    with served(reply) as server:
        async with asking(server.url, attempts=2, **limits) as asked:
            with pytest.raises(ModelError, match=f"after 2 attempts: .*{why}") as raised:
                await asked.client.ask(MESSAGES, {})
    assert raised.value.fields["why"] == "unreachable"
    assert [why in line for line in asked.lines] == [True], "the second attempt is the last"


async def test_an_address_without_server_is_reported() -> None:
    with served(silent) as server:
        url = server.url
    async with asking(url, attempts=1) as asked:
        with pytest.raises(ModelError, match="after 1 attempts"):
            await asked.client.ask(MESSAGES, {})


async def test_an_endless_answer_is_cut_at_its_limit() -> None:
    with served(endless) as server:
        async with asking(server.url, answer_tokens=20) as asked:
            answer = await asked.client.ask(MESSAGES, {})
        assert server.left.wait(30)
    assert not answer.complete
    assert len(answer.text) < 20 * 2 * 4 + 100
    assert 20 <= asked.client.answer_tokens <= 100


async def test_an_answer_cut_by_the_server_is_not_complete() -> None:
    with served(answering("{", finish="length")) as server:
        async with asking(server.url) as asked:
            assert not (await asked.client.ask(MESSAGES, {})).complete


@pytest.mark.parametrize("reply", [refusing("I cannot help."), answering("", finish="content_filter")])
async def test_a_refusal_of_the_model_is_not_repeated(reply: Reply) -> None:
    with served(reply) as server:
        async with asking(server.url) as asked:
            with pytest.raises(ModelError, match="made refuses: ") as raised:
                await asked.client.ask(MESSAGES, {})
    assert raised.value.fields["why"] == "refused"
    assert len(server.requests) == 1


@pytest.mark.parametrize(
    ("reply", "why"), [(failing(401, "bad key"), "http"), (failing(302), "http"), (foreign, "malformed")]
)
async def test_a_wrong_address_or_key_is_not_repeated(reply: Reply, why: str) -> None:
    with served(reply) as server:
        async with asking(server.url) as asked:
            with pytest.raises(ModelError) as raised:
                await asked.client.ask(MESSAGES, {})
    assert raised.value.fields["why"] == why
    assert len(server.requests) == 1


async def test_a_proxy_of_the_environment_is_not_used(monkeypatch: pytest.MonkeyPatch) -> None:
    """It would get the key and the text of the protocol."""
    for name in ("HTTP_PROXY", "http_proxy", "ALL_PROXY", "all_proxy"):
        monkeypatch.setenv(name, "http://127.0.0.1:9")
    with served(answering("yes")) as server:
        async with asking(server.url, attempts=1) as asked:
            assert (await asked.client.ask(MESSAGES, {})).text == "yes"


async def test_a_redirection_is_not_followed() -> None:
    with served(failing(307, Location="http://127.0.0.1:9/other")) as server:
        async with asking(server.url, key="secret") as asked:
            with pytest.raises(ModelError, match="answers 307"):
                await asked.client.ask(MESSAGES, {})


async def test_tokens_are_estimated_if_the_server_counts_none() -> None:
    with served(answering("x" * 400, usage=None)) as server:
        async with asking(server.url, request_price=1e6, answer_price=2e6) as asked:
            await asked.client.ask(MESSAGES, {})
    assert (asked.client.request_tokens, asked.client.answer_tokens) == (10, 100)
    assert asked.client.cost == 210.0


@pytest.mark.parametrize(
    "limits", [{"total_tokens": 1000}, {"total_cost": 1.0, "request_price": 1e3, "answer_price": 1e3}]
)
async def test_nothing_is_asked_that_could_exceed_a_limit(limits: dict[str, Any]) -> None:
    """The first question uses 960 tokens; the next one may use 10 of request and 40 of answer."""
    with served(answering("yes", usage=(900, 60))) as server:
        async with asking(server.url, answer_tokens=40, **limits) as asked:
            await asked.client.ask(MESSAGES, {})
            with pytest.raises(ModelError, match="could exceed") as raised:
                await asked.client.ask(MESSAGES, {})
    assert raised.value.fields["why"] == "limit"
    assert len(server.requests) == 1


async def test_broken_attempts_count_towards_the_limit() -> None:
    with served(breaking) as server:
        async with asking(server.url, attempts=50, answer_tokens=40, total_tokens=100) as asked:
            with pytest.raises(ModelError, match="total_tokens = 100"):
                await asked.client.ask(MESSAGES, {})
    assert 1 < len(server.requests) < 10


@pytest.mark.parametrize("url", ["", "ftp://host/v1", "http:///v1", "http://user:word@127.0.0.1/v1"])
async def test_an_address_that_is_not_possible_is_refused(url: str) -> None:
    with pytest.raises(ConfigurationError):
        async with asking(url):
            pytest.fail("It opens.")
