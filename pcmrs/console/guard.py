"""Access control of the page: a request needs the token and must come from a page of this console."""

from __future__ import annotations

import hmac
from collections.abc import Awaitable, Callable, Iterable, MutableMapping
from http.cookies import CookieError, SimpleCookie
from typing import Any
from urllib.parse import parse_qs

from pcmrs.errors import ConfigurationError

SHORTEST = 20
"""Characters of the shortest accepted token: one of `secrets.token_urlsafe` has more."""

Scope = MutableMapping[str, Any]
Receive = Callable[[], Awaitable[MutableMapping[str, Any]]]
Send = Callable[[MutableMapping[str, Any]], Awaitable[None]]
App = Callable[[Scope, Receive, Send], Awaitable[None]]


class TokenMiddleware:
    """Middleware in front of the whole application, also for WebSockets.

    The token comes once with the address, ``/?token=...``, and is then stored as a cookie. The names under which the
    console is reached are fixed, so that a foreign name that points here (DNS rebinding) opens nothing, and
    foreign pages can neither connect nor post.

    Args:
        app: Application behind it.
        token: Token that a request needs.
        hosts: ``host:port`` of the addresses at which the console is reached.

    Raises:
        ConfigurationError: The token is empty, or so short that it could be guessed.
    """

    def __init__(self, app: App, token: str, hosts: Iterable[str]) -> None:
        if len(token) < SHORTEST:
            text = f"The console's token has {len(token)} characters, the minimum is {SHORTEST}: it could be guessed. "
            text += "Delete the file, so that the daemon makes a new one, or write a longer one into it."
            raise ConfigurationError(text, characters=len(token), limit=SHORTEST)
        self._app = app
        self._token = token.encode()
        self._hosts = frozenset(hosts)

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Let a request through, or answer it here."""
        if scope["type"] == "lifespan":
            await self._app(scope, receive, send)
            return
        headers = {name.decode("latin-1").lower(): value.decode("latin-1") for name, value in scope["headers"]}
        refusal = self._refusal(scope, headers)
        if refusal is None:
            await self._app(scope, receive, send)
        elif scope["type"] == "websocket":
            await send({"type": "websocket.close", "code": 1008})
        else:
            status, text, more = refusal
            # Who has no token keeps no connection. A browser that is sent on opens another one.
            await answer(send, status, text, more | {"connection": "close"})

    def _refusal(self, scope: Scope, headers: dict[str, str]) -> tuple[int, str, dict[str, str]] | None:
        """Return status, text and headers of the answer to a refused request; None if it may pass."""
        host, origin = headers.get("host", ""), headers.get("origin")
        # Before the token: a foreign name must not even learn whether a token is right.
        if host not in self._hosts:
            return 421, "This console does not have that name.", {}
        # Browsers send the origin with WebSockets and posts; other foreign requests lack the SameSite=Strict cookie.
        if (origin is not None or scope["type"] == "websocket") and origin not in (f"http://{host}", f"https://{host}"):
            return 403, "Pages of other sites may not use this console.", {}
        name = cookie_name(host)
        if self._is_token(_cookie(headers.get("cookie", ""), name)):
            return None
        given = parse_qs(scope.get("query_string", b"").decode("latin-1")).get("token", [""])[0]
        # Redirected, so that the token is not left in the address bar and the history.
        if scope["type"] == "http" and scope["method"] == "GET" and self._is_token(given):
            cookie = f"{name}={given}; Path=/; HttpOnly; SameSite=Strict"
            return 303, "", {"location": scope["path"], "set-cookie": cookie}
        return 401, "Open the address with its token: the console has printed it, and the cell's folder has it.", {}

    def _is_token(self, given: str) -> bool:
        # Its time does not depend on how many characters are right.
        return hmac.compare_digest(given.encode(), self._token)


def cookie_name(host: str) -> str:
    """Return the name of the cookie at ``host:port``.

    The name has the port, because browsers send a host's cookies to all its ports.
    """
    port = host.rpartition(":")[2]
    return f"pcmrs_console_{port}" if port.isdecimal() else "pcmrs_console"


def _cookie(header: str, name: str) -> str:
    try:
        found = SimpleCookie(header).get(name)
    except CookieError:
        return ""
    return "" if found is None else found.value


async def answer(send: Send, status: int, text: str, more: dict[str, str]) -> None:
    """Answer a request with a text.

    Args:
        send: Sends the parts of the answer.
        status: HTTP status.
        text: The text.
        more: Further headers.
    """
    headers = {"content-type": "text/plain; charset=utf-8", "cache-control": "no-store", **more}
    listed = [(name.encode(), value.encode("latin-1")) for name, value in headers.items()]
    await send({"type": "http.response.start", "status": status, "headers": listed})
    await send({"type": "http.response.body", "body": text.encode()})
