"""Who may open the page: whoever has the token, from a page of this console; everybody else gets nothing."""

from __future__ import annotations

import hmac
from collections.abc import Awaitable, Callable, Iterable, MutableMapping
from http.cookies import CookieError, SimpleCookie
from typing import Any
from urllib.parse import parse_qs

from pcmrs.errors import ConfigurationError

SHORTEST = 20
"""Characters of the shortest token that is taken: one of `secrets.token_urlsafe` has more."""

Scope = MutableMapping[str, Any]
Receive = Callable[[], Awaitable[MutableMapping[str, Any]]]
Send = Callable[[MutableMapping[str, Any]], Awaitable[None]]
App = Callable[[Scope, Receive, Send], Awaitable[None]]


class Guard:
    """Stands before the whole application, WebSockets too.

    The token comes once with the address, ``/?token=...``, and is a cookie from then on. The names under which the
    console is reached are fixed, so that a name that somebody else has pointed here (DNS rebinding) opens nothing, and
    pages of others can neither connect nor post.

    Args:
        app: What is behind it.
        token: Whoever has it is let in.
        hosts: ``host:port`` of the addresses at which the console is reached.

    Raises:
        ConfigurationError: The token is so short that it could be guessed, or empty.
    """

    def __init__(self, app: App, token: str, hosts: Iterable[str]) -> None:
        if len(token) < SHORTEST:
            text = f"The console's token has {len(token)} characters, the limit is {SHORTEST}: anybody could guess it. "
            text += "Delete the file, and the daemon makes a new one; or write a longer one into it."
            raise ConfigurationError(text, characters=len(token), limit=SHORTEST)
        self._app = app
        self._token = token.encode()
        self._hosts = frozenset(hosts)

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Let a request through, or answers it here."""
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
            await answer(send, status, text, more)

    def _refusal(self, scope: Scope, headers: dict[str, str]) -> tuple[int, str, dict[str, str]] | None:
        """Status, text and headers of the answer to a request that does not get through."""
        host, origin = headers.get("host", ""), headers.get("origin")
        if host not in self._hosts:
            return 421, "This console does not go by that name.", {}
        if (origin is not None or scope["type"] == "websocket") and origin not in (f"http://{host}", f"https://{host}"):
            return 403, "Pages of others may not talk to this console.", {}
        name = cookie_name(host)
        if self._is_token(_cookie(headers.get("cookie", ""), name)):
            return None
        given = parse_qs(scope.get("query_string", b"").decode("latin-1")).get("token", [""])[0]
        if scope["type"] == "http" and scope["method"] == "GET" and self._is_token(given):
            cookie = f"{name}={given}; Path=/; HttpOnly; SameSite=Strict"
            return 303, "", {"location": scope["path"], "set-cookie": cookie}
        return 401, "Open the address with its token: the console has printed it, or the cell's folder has it.", {}

    def _is_token(self, given: str) -> bool:
        return hmac.compare_digest(given.encode(), self._token)


def cookie_name(host: str) -> str:
    """Of the cookie at ``host:port``: browsers send a host's cookies to all its ports, so the name has the port."""
    port = host.rpartition(":")[2]
    return f"pcmrs_console_{port}" if port.isdecimal() else "pcmrs_console"


def _cookie(header: str, name: str) -> str:
    try:
        found = SimpleCookie(header).get(name)
    except CookieError:
        return ""
    return "" if found is None else found.value


async def answer(send: Send, status: int, text: str, more: dict[str, str]) -> None:
    """Answers a request with a text; `more` are further headers."""
    headers = {"content-type": "text/plain; charset=utf-8", "cache-control": "no-store", **more}
    listed = [(name.encode(), value.encode("latin-1")) for name, value in headers.items()]
    await send({"type": "http.response.start", "status": status, "headers": listed})
    await send({"type": "http.response.body", "body": text.encode()})
