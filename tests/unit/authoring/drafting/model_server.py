"""A server that speaks the chat completions of OpenAI over HTTP, with answers that a test has made.

The pieces have the shapes that llama.cpp, Ollama and vLLM document for `stream = true`: an event for each piece, the
usage in a last event without choices, and `[DONE]`. No answer in the tests was recorded from a model.
"""

from __future__ import annotations

import json
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

PIECE = 40
"""Characters of an answer in one event."""


class Exchange(BaseHTTPRequestHandler):
    """One request. A reply writes to it."""

    protocol_version = "HTTP/1.1"
    server: ModelServer

    def do_POST(self) -> None:
        body = self.rfile.read(int(self.headers["Content-Length"]))
        self.close_connection = True
        self.server.requests.append(json.loads(body) | {"path": self.path, "key": self.headers["Authorization"]})
        try:
            self.server.next_reply()(self)
        except (BrokenPipeError, ConnectionResetError):
            self.server.left.set()

    def log_message(self, *_arguments: Any) -> None:
        """Print nothing."""

    def begin(self, status: int = 200, kind: str = "text/event-stream", **headers: str) -> None:
        self.send_response(status)
        for name, value in {"Content-Type": kind, "Transfer-Encoding": "chunked", **headers}.items():
            self.send_header(name.replace("_", "-"), value)
        self.end_headers()

    def send(self, data: bytes) -> None:
        self.wfile.write(b"%x\r\n%s\r\n" % (len(data), data))
        self.wfile.flush()

    def event(self, content: dict[str, Any]) -> None:
        self.send(b"data: " + json.dumps(content).encode() + b"\n\n")

    def piece(self, finish: str | None = None, **delta: str) -> None:
        self.event({
            "id": "chatcmpl-1", "object": "chat.completion.chunk", "created": 1, "model": "made",
            "choices": [{"index": 0, "delta": delta, "finish_reason": finish, "logprobs": None}],
        })  # fmt: skip

    def end(self, *, usage: tuple[int, int] | None = (100, 50)) -> None:
        if usage is not None:
            self.event({"choices": [], "usage": {"prompt_tokens": usage[0], "completion_tokens": usage[1]}})
        self.send(b"data: [DONE]\n\n")
        self.wfile.write(b"0\r\n\r\n")


Reply = Callable[[Exchange], None]


class ModelServer(ThreadingHTTPServer):
    """The server.

    Attributes:
        requests: Bodies of all requests so far, with path and key.
        left: Set when a client has closed the connection before the reply ended.
        closing: Set when the server ends: a silent reply waits for it.
    """

    daemon_threads = True

    def __init__(self, replies: tuple[Reply, ...]) -> None:
        super().__init__(("127.0.0.1", 0), Exchange)
        self.requests: list[dict[str, Any]] = []
        self.left, self.closing = threading.Event(), threading.Event()
        self._replies = iter(replies)
        self._last = replies[-1]

    @property
    def url(self) -> str:
        return f"http://127.0.0.1:{self.server_address[1]}/v1"

    def next_reply(self) -> Reply:
        """Return the next reply; the last one is repeated."""
        return next(self._replies, self._last)


@contextmanager
def served(*replies: Reply) -> Iterator[ModelServer]:
    """Serve replies, one for each request, on a free port of this machine."""
    with ModelServer(replies) as server:
        thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.01})
        thread.start()
        try:
            yield server
        finally:
            server.closing.set()
            server.shutdown()
            thread.join()


def answering(text: str, *, finish: str = "stop", usage: tuple[int, int] | None = (100, 50)) -> Reply:
    """Reply with a text in pieces."""

    def reply(exchange: Exchange) -> None:
        exchange.begin()
        exchange.send(b": ping\n\n")
        exchange.piece(role="assistant", content="")
        for start in range(0, len(text), PIECE):
            exchange.piece(content=text[start : start + PIECE])
        exchange.piece(finish)
        exchange.end(usage=usage)

    return reply


def refusing(reason: str) -> Reply:
    def reply(exchange: Exchange) -> None:
        exchange.begin()
        exchange.piece(refusal=reason)
        exchange.piece("stop")
        exchange.end()

    return reply


def failing(status: int, text: str = "no", **headers: str) -> Reply:
    def reply(exchange: Exchange) -> None:
        exchange.begin(status, "application/json", **headers)
        exchange.send(json.dumps({"error": {"message": text}}).encode())
        exchange.wfile.write(b"0\r\n\r\n")

    return reply


def endless(exchange: Exchange) -> None:
    """Send pieces until the client leaves."""
    exchange.begin()
    while not exchange.server.closing.is_set():
        exchange.piece(content="x" * PIECE)


def silent(exchange: Exchange) -> None:
    """Send the head of a response, and then nothing."""
    exchange.begin()
    exchange.server.closing.wait()


def trickling(exchange: Exchange) -> None:
    """Send comments that keep the connection open, and no answer."""
    exchange.begin()
    while not exchange.server.closing.wait(0.01):
        exchange.send(b": ping\n\n")


def breaking(exchange: Exchange) -> None:
    """Close the connection within the answer."""
    exchange.begin()
    exchange.piece(content='{"id": "half')


def foreign(exchange: Exchange) -> None:
    """Send events of another interface."""
    exchange.begin()
    exchange.event({"choices": "none"})


def ending_early(exchange: Exchange) -> None:
    """End the response properly, but without an end of the answer."""
    exchange.begin()
    exchange.piece(content="half")
    exchange.wfile.write(b"0\r\n\r\n")


def reporting_failure(exchange: Exchange) -> None:
    """Report a failure as an event, as servers do that have sent the status already."""
    exchange.begin()
    exchange.event({"error": {"message": "out of memory", "code": 500}})
