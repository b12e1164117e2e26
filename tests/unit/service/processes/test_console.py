"""The page of a cell: its address works from the start, its process starts when it is opened, its token stays."""

from __future__ import annotations

import asyncio
import sys
from asyncio.subprocess import PIPE
from pathlib import Path

import pytest

from pcmrs.console.settings import HOST, TOKEN, UPLOADS, ConsoleSettings
from pcmrs.processes.starting import Process
from pcmrs.service.processes import console
from pcmrs.service.processes.console import ConsoleListener, is_served
from pcmrs.settings import CellSettings, Settings
from pcmrs.testing.clock import settle
from pcmrs.testing.daemon import free_port

WITHIN = 60.0
PROGRAM = """
import socket, sys
assert sys.stdin.readline().startswith("{")
connection, _ = socket.socket(fileno=int(sys.argv[-1])).accept()
connection.sendall(" ".join(sys.argv[1:-1]).encode())
"""
"""Answers the first connection with its own command line."""


async def start(
    module: str, *words: str, stdin: int = PIPE, stdout: int | None = None, passed: int | None = None
) -> Process:
    """Starts a small program instead of the web server."""
    given = () if passed is None else (passed,)
    return await asyncio.create_subprocess_exec(
        sys.executable, "-c", PROGRAM, module, *words, stdin=stdin, stdout=stdout, pass_fds=given
    )


def listener(folder: Path, port: int) -> ConsoleListener:
    return ConsoleListener(start, Settings(cell=CellSettings(folder=str(folder)), console=ConsoleSettings(port=port)))


async def test_first_connection_starts_the_process_that_answers(tmp_path: Path) -> None:
    page = listener(tmp_path, port := free_port())
    page.open()
    assert page.address == f"http://{HOST}:{port}"
    async with asyncio.timeout(WITHIN):
        beginning = asyncio.create_task(page.begin())
        await settle()
        assert not beginning.done(), "the page has not been opened"
        reader, writer = await asyncio.open_connection(HOST, port)
        process = await beginning
        assert await reader.read() == b"pcmrs.cli console --lifeline --listening"
        writer.close()
        assert await process.wait() == 0
        again = await page.begin()
        _, writer = await asyncio.open_connection(HOST, port)
        assert await again.wait() == 0, "it was restarted before anybody has connected"
        writer.close()
    page.close()


async def test_left_files_of_patients_start_the_process_at_once(tmp_path: Path) -> None:
    """It removes them."""
    (tmp_path / UPLOADS / "killed").mkdir(parents=True)
    page = listener(tmp_path, free_port())
    page.open()
    beginning = asyncio.create_task(page.begin())
    await settle()
    assert not beginning.done(), "an empty folder holds no files"
    beginning.cancel()
    await asyncio.gather(beginning, return_exceptions=True)
    (tmp_path / UPLOADS / "killed" / "head.nii").write_bytes(b"voxels")
    async with asyncio.timeout(WITHIN):
        process = await page.begin()
        process.kill()
        await process.wait()
    page.close()


async def test_closed_listener_ends_connections_that_wait(tmp_path: Path) -> None:
    page = listener(tmp_path, port := free_port())
    page.open()
    async with asyncio.timeout(WITHIN):
        reader, writer = await asyncio.open_connection(HOST, port)
        page.close()
        with pytest.raises(ConnectionResetError):
            await reader.read()
        writer.close()
        with pytest.raises(ConnectionRefusedError):
            await asyncio.open_connection(HOST, port)
    assert page.address == ""


def test_token_is_secret_and_stays_the_same(tmp_path: Path) -> None:
    """Bookmarks of the page hold it."""
    file, tokens = tmp_path / TOKEN, set[bytes]()
    for _ in range(2):
        page = listener(tmp_path, free_port())
        page.open()
        page.close()
        tokens.add(file.read_bytes())
        assert file.stat().st_mode & 0o777 == 0o600
    (token,) = tokens
    assert len(token) >= 32


def test_cells_have_different_tokens(tmp_path: Path) -> None:
    tokens = set[bytes]()
    for name in ("a", "b"):
        (tmp_path / name).mkdir()
        page = listener(tmp_path / name, free_port())
        page.open()
        page.close()
        tokens.add((tmp_path / name / TOKEN).read_bytes())
    assert len(tokens) == 2


async def test_folder_that_cannot_be_written_costs_the_page(tmp_path: Path) -> None:
    page = listener(tmp_path / "gone", free_port())
    page.open()
    assert page.address == ""
    with pytest.raises(OSError, match="gone"):
        await page.begin()


async def test_taken_port_costs_the_page(tmp_path: Path) -> None:
    first = listener(tmp_path, port := free_port())
    first.open()
    second = listener(tmp_path, port)
    second.open()
    assert second.address == ""
    with pytest.raises(OSError, match="in use"):
        await second.begin()
    first.close()


@pytest.mark.parametrize("installed", [True, False])
@pytest.mark.parametrize("enabled", [True, False])
def test_page_needs_the_setting_and_the_package(
    monkeypatch: pytest.MonkeyPatch, enabled: bool, installed: bool
) -> None:
    monkeypatch.setattr(console, "find_spec", lambda name: object() if installed and name == "nicegui" else None)
    assert is_served(Settings(console=ConsoleSettings(enabled=enabled))) == (enabled and installed)
