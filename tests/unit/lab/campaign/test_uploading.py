"""Uploads of a program: what they send to the console, and what they make of its page."""

from __future__ import annotations

import asyncio
from collections.abc import Iterable
from typing import cast

import pytest

from pcmrs.testing.driving import PATIENCE
from pcmrs.testing.errors import Unmet
from pcmrs.testing.loop import run_on_simulated_loop
from pcmrs_lab.campaign.consoles import RunningConsole
from pcmrs_lab.campaign.uploading import NAME, TAKEN, Uploader, uploader

PAGE = b'<html><q-uploader url="/_nicegui/client/7f-e2/upload/12"></html>'


class ScriptedConsole:
    """A console with these pages, one after the other; the last one for good."""

    def __init__(self, *pages: bytes) -> None:
        self.pages = list(pages)
        self.requests: list[tuple[str, tuple[str, ...], bytes]] = []
        self.asked_at: list[float] = []

    async def request(self, head: str, *headers: str, body: Iterable[bytes] = ()) -> tuple[int, bytes]:
        self.requests.append((head, headers, b"".join(body)))
        self.asked_at.append(asyncio.get_running_loop().time())
        return TAKEN, self.pages.pop(0) if self.pages[1:] else self.pages[0]

    @property
    def as_console(self) -> RunningConsole:
        return cast(RunningConsole, self)


@pytest.fixture
def console() -> ScriptedConsole:
    return ScriptedConsole(b"taken \xff")


@pytest.fixture
def upload(console: ScriptedConsole) -> Uploader:
    return Uploader(console.as_console, "/up")


async def test_a_file_is_sent_as_a_form_of_its_length(console: ScriptedConsole, upload: Uploader) -> None:
    assert await upload.send(b"solid head") == TAKEN
    ((head, headers, body),) = console.requests
    assert head == "POST /up"
    assert f"Content-Length: {len(body)}" in headers
    boundary = headers[0].partition("boundary=")[2]
    assert body.startswith(f"--{boundary}\r\n".encode())
    assert body.endswith(f"\r\nsolid head\r\n--{boundary}--\r\n".encode())
    assert f'filename="{NAME}"'.encode() in body


async def test_a_file_is_sent_without_a_length(console: ScriptedConsole, upload: Uploader) -> None:
    assert await upload.send_without_length(b"solid head") == (TAKEN, "taken \N{REPLACEMENT CHARACTER}")
    ((_, headers, body),) = console.requests
    assert "Transfer-Encoding: chunked" in headers
    assert not any(header.startswith("Content-Length") for header in headers)
    pieces = []
    while body:
        length, _, body = body.partition(b"\r\n")
        pieces.append(body[: int(length, 16)])
        assert body[int(length, 16) :][:2] == b"\r\n"
        body = body[int(length, 16) + 2 :]
    assert pieces[-1] == b""
    await upload.send(b"solid head")
    assert b"".join(pieces) == console.requests[1][2], "the same form"


async def test_a_length_may_be_announced_that_never_comes(console: ScriptedConsole, upload: Uploader) -> None:
    await upload.announce(1 << 40)
    ((_, headers, body),) = console.requests
    assert f"Content-Length: {1 << 40}" in headers
    assert body == b""


def test_the_upload_is_found_when_the_page_has_it() -> None:
    console = ScriptedConsole(b"", b"<html>not yet</html>", PAGE, b"taken")

    async def find() -> int:
        found = await uploader(console.as_console)
        return await found.send(b"")

    assert run_on_simulated_loop(find()) == TAKEN
    assert [head for head, _, _ in console.requests][2:] == ["GET /", "POST /_nicegui/client/7f-e2/upload/12"]


def test_a_page_without_an_upload_is_unmet() -> None:
    console = ScriptedConsole(b"<html></html>")
    with pytest.raises(Unmet, match="showed no upload"):
        run_on_simulated_loop(uploader(console.as_console))
    assert console.asked_at[-1] - console.asked_at[0] == pytest.approx(PATIENCE, abs=1.0)
