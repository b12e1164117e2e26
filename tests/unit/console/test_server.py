"""The server of the page says where it cannot listen; what it answers to whom: test_guard.py."""

from __future__ import annotations

import asyncio
import socket
import tempfile
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import pytest

from pcmrs.console.server import ListenAddress, serve_console
from pcmrs.errors import BusError, ConfigurationError

TOKEN = "a token of more than twenty characters"


@pytest.fixture(autouse=True)
def own_temporary_folder(monkeypatch: pytest.MonkeyPatch) -> None:
    """The console moves the folder of all temporary files."""
    monkeypatch.setattr(tempfile, "tempdir", None)


@asynccontextmanager
async def no_daemon() -> AsyncIterator[Any]:
    raise BusError("No daemon answers.")
    yield


async def serve(place: ListenAddress, token: str, folder: Path, ended: asyncio.Event, urls: list[str]) -> None:
    await serve_console(no_daemon, place, token, "en", urls.append, ended, folder / "uploads")


async def test_a_port_that_is_taken_is_named_and_nothing_is_made(tmp_path: Path) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        with pytest.raises(BusError, match="Give another --port") as error:
            await serve(ListenAddress(port=port), TOKEN, tmp_path, asyncio.Event(), [])
    assert error.value.fields == {"host": "127.0.0.1", "port": port}
    assert not (tmp_path / "uploads").exists()


async def test_an_address_of_another_machine_is_refused(tmp_path: Path) -> None:
    with pytest.raises(BusError, match=r"cannot listen at 192\.0\.2\.1:0"):
        await serve(ListenAddress(host="192.0.2.1", port=0), TOKEN, tmp_path, asyncio.Event(), [])


async def test_port_is_free_again_after_a_token_that_is_too_short(tmp_path: Path) -> None:
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    with pytest.raises(ConfigurationError, match="token has 5 characters") as error:
        await serve(ListenAddress(port=port), "short", tmp_path, asyncio.Event(), [])
    with socket.create_server(("127.0.0.1", port)):
        assert error.value.fields["characters"] == 5
