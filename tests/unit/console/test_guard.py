"""Who has no token, comes by another name or from a page of others gets nothing of the console."""

from __future__ import annotations

import http.client
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from urllib.parse import urlsplit
from urllib.request import HTTPCookieProcessor, build_opener

import pytest

from pcmrs.cli.running import EXIT_BAD_CONFIGURATION
from pcmrs.console.guard import TokenMiddleware, cookie_name
from pcmrs.errors import ConfigurationError
from pcmrs.testing.daemon import free_port
from tests.system.console.consoles import console

HANDSHAKE = {
    "Connection": "Upgrade", "Upgrade": "websocket", "Sec-WebSocket-Version": "13",
    "Sec-WebSocket-Key": "dGhlIHNhbXBsZSBub25jZQ==",
}  # fmt: skip
SOCKET = "/_nicegui_ws/socket.io/?EIO=4&transport=websocket"


@pytest.fixture(scope="module")
def address() -> Iterator[tuple[str, str]]:
    """Host with port, and token, of a console that reaches no daemon."""
    with console("--endpoint", f"tcp/127.0.0.1:{free_port()}") as (_, url):
        parts = urlsplit(url)
        yield parts.netloc, parts.query.removeprefix("token=")


def ask(netloc: str, path: str, method: str = "GET", **headers: str) -> http.client.HTTPResponse:
    connection = http.client.HTTPConnection(netloc, timeout=20.0)
    connection.putrequest(method, path, skip_host="Host" in headers)
    for name, value in headers.items():
        connection.putheader(name, value)
    connection.endheaders()
    response = connection.getresponse()
    response.body = response.read()  # type: ignore[attr-defined]
    connection.close()
    return response


@pytest.mark.parametrize(
    "path", ["/", "/?token=", "/?token=wrong", "/body.stl", "/_nicegui/3.18.0/components/x", SOCKET]
)
@pytest.mark.parametrize("cookie", ["", "{name}=wrong", "{name}=", "other=1"])
def test_without_the_token_there_is_nothing(address: tuple[str, str], path: str, cookie: str) -> None:
    cookie = cookie.format(name=cookie_name(address[0]))
    response = ask(address[0], path, **({"Cookie": cookie} if cookie else {}))
    assert response.status == 401
    assert response.getheader("Connection") == "close", "who has no token keeps no place"
    assert b"nicegui" not in response.body  # type: ignore[attr-defined]


def test_the_token_becomes_a_cookie_that_scripts_cannot_read(address: tuple[str, str]) -> None:
    netloc, token = address
    response = ask(netloc, f"/?token={token}")
    assert (response.status, response.getheader("Location")) == (303, "/")
    cookie = response.getheader("Set-Cookie") or ""
    assert {"HttpOnly", "SameSite=Strict"} <= {part.strip() for part in cookie.split(";")}
    page = ask(netloc, "/", Cookie=cookie.partition(";")[0])
    assert page.status == 200
    body: bytes = page.body  # type: ignore[attr-defined]
    assert not re.findall(rb'(?:src|href)="(?:https?:)?//', body), "nothing is loaded from elsewhere"
    assert token.encode() not in body


@pytest.mark.parametrize("host", ["evil.example", "evil.example:8080", "127.0.0.1", "127.0.0.1:1", ""])
def test_by_another_name_there_is_nothing(address: tuple[str, str], host: str) -> None:
    netloc, token = address
    assert ask(netloc, "/", Host=host, Cookie=f"{cookie_name(netloc)}={token}").status in (400, 421)


@pytest.mark.parametrize("origin", ["http://evil.example", "null", "http://127.0.0.1:1", "file://"])
def test_pages_of_others_get_nothing(address: tuple[str, str], origin: str) -> None:
    netloc, token = address
    assert ask(netloc, "/", Origin=origin, Cookie=f"{cookie_name(netloc)}={token}").status == 403
    assert ask(netloc, SOCKET, Origin=origin, Cookie=f"{cookie_name(netloc)}={token}", **HANDSHAKE).status == 403


def test_a_websocket_needs_origin_and_token(address: tuple[str, str]) -> None:
    netloc, token = address
    own = {"Origin": f"http://{netloc}", "Cookie": f"{cookie_name(netloc)}={token}"}
    assert ask(netloc, SOCKET, Cookie=own["Cookie"], **HANDSHAKE).status == 403
    assert ask(netloc, SOCKET, Origin=own["Origin"], **HANDSHAKE).status == 403


def test_a_browser_can_be_signed_in_to_two_consoles_of_one_host(address: tuple[str, str]) -> None:
    netloc, token = address
    browser = build_opener(HTTPCookieProcessor())  # keeps cookies by host, whatever the port, as browsers do
    with console("--endpoint", f"tcp/127.0.0.1:{free_port()}") as (_, other):
        for url in (f"http://{netloc}/?token={token}", other, f"http://{netloc}/", other.partition("?")[0]):
            with browser.open(url, timeout=20.0) as page:
                assert page.status == 200


async def nothing(*_: object) -> None:
    """An application."""


@pytest.mark.parametrize("token", ["", "nineteen-characters"])
def test_a_token_that_could_be_guessed_is_refused(token: str) -> None:
    with pytest.raises(ConfigurationError, match="minimum is 20") as refused:
        TokenMiddleware(nothing, token, [])
    assert refused.value.fields == {"characters": len(token), "limit": 20}
    TokenMiddleware(nothing, "the-twenty-character", [])


def test_a_token_that_could_be_guessed_opens_no_console(tmp_path: Path) -> None:
    file = tmp_path / "token"
    file.write_text("nineteen-characters\n")  # the end of the line is none of its characters
    file.chmod(0o600)
    words = ["--endpoint", f"tcp/127.0.0.1:{free_port()}", "--port", "0", "--token-file", str(file)]
    ended = subprocess.run([sys.executable, "-m", "pcmrs.cli", "console", *words], capture_output=True, text=True)
    assert ended.returncode == EXIT_BAD_CONFIGURATION
    assert "minimum is 20" in ended.stderr
