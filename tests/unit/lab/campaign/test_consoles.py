"""A console of a campaign: its command line, its start, and requests that a program sends to it."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager, suppress
from pathlib import Path
from typing import Any, cast

import pytest

from pcmrs.console.guard import cookie_name
from pcmrs.testing.errors import Unmet
from pcmrs_lab.campaign import consoles
from pcmrs_lab.campaign.consoles import RunningConsole, console_command, running_console
from tests.unit.lab.campaign.scripted_cell import ScriptedCell
from tests.unit.lab.campaign.scripted_child import ScriptedChild, started

SERVES = b'{"url": "http://127.0.0.1:8080"}\n'

Answer = Callable[[asyncio.StreamReader, asyncio.StreamWriter], Awaitable[None]]


@asynccontextmanager
async def answering(answer: Answer) -> AsyncIterator[RunningConsole]:
    served: list[asyncio.Task[Any]] = []

    async def serve(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        served.append(cast(asyncio.Task[Any], asyncio.current_task()))
        try:
            await answer(reader, writer)
        finally:
            writer.close()
            with suppress(ConnectionError):
                await writer.wait_closed()

    server = await asyncio.start_server(serve, "127.0.0.1", 0)
    port = server.sockets[0].getsockname()[1]
    async with server:
        yield RunningConsole(cast(asyncio.subprocess.Process, None), port, Path("uploads"))
        await asyncio.gather(*served)


async def test_a_request_is_that_of_a_program_with_the_token() -> None:
    heads: list[bytes] = []

    async def answer(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        heads.append(await reader.readuntil(b"\r\n\r\n") + await reader.readexactly(5))
        writer.write(b"HTTP/1.1 413 Too Large\r\nServer: x\r\n\r\nmuch\r\n\r\ntoo much")

    async with answering(answer) as console:
        found = await console.request("POST /up", "Content-Length: 5", body=[b"ab", b"cde"])
        name = f"127.0.0.1:{console.port}"
    assert found == (413, b"much\r\n\r\ntoo much")
    head, _, body = heads[0].decode().partition("\r\n\r\n")
    assert head.splitlines()[:2] == ["POST /up HTTP/1.1", f"Host: {name}"]
    assert f"Cookie: {cookie_name(name)}=token-of-the-campaign" in head
    assert (head.splitlines()[-1], body) == ("Content-Length: 5", "abcde")


async def test_a_connection_that_ends_without_an_answer_is_0() -> None:
    async def hang_up(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        pass

    async with answering(hang_up) as console:
        assert await console.request("GET /") == (0, b"")


async def test_a_connection_that_is_broken_off_is_0() -> None:
    async def break_off(_: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        writer.transport.abort()

    async with answering(break_off) as console:
        assert await console.request("POST /up", body=[bytes(1 << 16)] * 64) == (0, b"")


async def test_a_request_without_an_answer_in_time_is_unmet(monkeypatch: pytest.MonkeyPatch) -> None:
    async def wait(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        await reader.read()

    monkeypatch.setattr(consoles, "ANSWERED_WITHIN", 0.05)
    async with answering(wait) as console:
        with pytest.raises(Unmet, match=r"GET / was not answered within 0\.05 s"):
            await console.request("GET /")


def test_a_console_is_started_for_the_cell_of_the_campaign() -> None:
    words = console_command(ScriptedCell(Path("cell7")).as_cell, 8080, Path("/t"))
    assert words[3:10] == ["console", "--endpoint", "tcp/127.0.0.1:9", "--site", "lab", "--cell", "cell1"]
    assert words[10:] == ["--port", "8080", "--json", "--token-file", "/t"]


async def test_a_console_serves_in_its_own_folder_until_the_end(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    child = ScriptedChild(SERVES)
    started(monkeypatch, child)
    async with running_console(ScriptedCell().as_cell, tmp_path, 8080) as console:
        assert (console.port, console.uploads.parent) == (8080, tmp_path / "pcmrs")
        assert child.returncode is None
    assert child.signals
    assert child.options["env"]["XDG_CACHE_HOME"] == str(tmp_path)
    assert (tmp_path / "console.token").stat().st_mode & 0o777 == 0o600


@pytest.mark.parametrize("output", [b"", b"Error: the port is in use\n"])
async def test_a_console_that_does_not_start_is_unmet(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, output: bytes
) -> None:
    child = ScriptedChild(output)
    started(monkeypatch, child)
    with pytest.raises(Unmet, match=f"did not start: {output.decode().strip()}"):
        async with running_console(ScriptedCell().as_cell, tmp_path, 8080):
            pass
    assert child.returncode is not None, "it does not outlive its row"


async def test_a_console_that_never_serves_is_unmet(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    started(monkeypatch, ScriptedChild(last=b"never"))
    monkeypatch.setattr(consoles, "START_TIME", 0.02)
    with pytest.raises(Unmet, match="did not serve its page within"):
        async with running_console(ScriptedCell().as_cell, tmp_path, 8080):
            pass
