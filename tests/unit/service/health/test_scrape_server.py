"""The server of the metrics: a few connections at a time, each for a short time."""

from __future__ import annotations

import socket
import threading
import time
import urllib.request
from collections.abc import Iterator
from urllib.error import URLError

import pytest
from prometheus_client import CollectorRegistry, Gauge

from pcmrs.service.health import _scrape_server as module
from pcmrs.service.health._scrape_server import MOST, ScrapeServer

HOST = "127.0.0.1"
TIMEOUT = 20.0
"""Longest wait of a test for one event, s."""


@pytest.fixture
def port() -> Iterator[int]:
    registry = CollectorRegistry()
    Gauge("answer", "A metric.", registry=registry).set(42)
    server = ScrapeServer(HOST, 0, registry)
    thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.02})
    thread.start()
    yield server.server_port
    server.shutdown()
    server.server_close()
    thread.join()


def connect(port: int) -> socket.socket:
    return socket.create_connection((HOST, port), TIMEOUT)


def has_ended(connection: socket.socket) -> bool:
    try:
        return connection.recv(1) == b""
    except ConnectionResetError:
        return True


def scrape(port: int) -> bytes:
    with urllib.request.urlopen(f"http://{HOST}:{port}/metrics", timeout=TIMEOUT) as answer:
        content: bytes = answer.read()
    return content


def scraped(port: int) -> bytes:
    """Metrics, once the server has noticed which connections are closed."""
    latest = time.monotonic() + TIMEOUT
    while True:
        try:
            return scrape(port)
        except (URLError, ConnectionError):
            if time.monotonic() > latest:
                raise


def test_one_connection_too_many_is_closed(port: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "WITHIN", 1e9)
    opened = [connect(port) for _ in range(MOST)]
    with connect(port) as excess:
        assert has_ended(excess)
    for each in opened:
        each.close()
    assert b"answer 42" in scraped(port)


@pytest.mark.parametrize("sent", [b"", b"GET /metr"])
def test_a_connection_without_a_request_ends(port: int, monkeypatch: pytest.MonkeyPatch, sent: bytes) -> None:
    opened = [connect(port) for _ in range(MOST)]
    monkeypatch.setattr(module, "WITHIN", 0.0)
    for each in opened:
        each.sendall(sent)
        while not has_ended(each):  # an error may be answered to half a request
            pass
        each.close()
    monkeypatch.undo()
    assert b"answer 42" in scraped(port)
