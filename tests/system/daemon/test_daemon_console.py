"""The page that a real daemon serves by a process of its own."""

from __future__ import annotations

import os
import signal
import socket
from pathlib import Path
from urllib.error import HTTPError, URLError
from urllib.request import HTTPCookieProcessor, build_opener

import pytest

from pcmrs.console.settings import TOKEN
from pcmrs.journal import JournalReader
from pcmrs.testing.cell import LIGHT
from pcmrs.testing.daemon import free_port
from pcmrs.testing.driving import accept
from tests.system.daemon.daemon_process import own_settings, running_daemon, wait_until


def with_page(folder: Path, port: int) -> list[str]:
    shown = [each for each in own_settings(folder) if not each.startswith("console.")]
    return [*shown, f"console.port={port}", *LIGHT]


def status(url: str) -> int:
    """Of the answer; 0 where nobody answers."""
    try:
        with build_opener(HTTPCookieProcessor()).open(url, timeout=20.0) as answer:
            return int(answer.status)
    except HTTPError as error:
        return error.code
    except (URLError, ConnectionError, TimeoutError):  # it is not there yet, or too busy to answer
        return 0


def test_page_opens_with_its_token_and_returns_after_a_kill(tmp_path: Path) -> None:
    with running_daemon(with_page(tmp_path, free_port()), tmp_path) as daemon:
        page, token = daemon.ready.console, tmp_path / TOKEN
        assert wait_until(lambda: status(page) == 401, 60.0), "nobody comes in without the token"
        assert token.stat().st_mode & 0o777 == 0o600
        opened = f"{page}/?token={token.read_text()}"
        assert token.read_text() not in (tmp_path / "log").read_text()
        killed = next(pid for pid in daemon.children() if b"console" in Path(f"/proc/{pid}/cmdline").read_bytes())
        os.kill(killed, signal.SIGKILL)
        assert wait_until(lambda: status(opened) == 200, 60.0), "the same address opens it again"
        with JournalReader(Path(daemon.ready.journal)) as journal:
            assert any(row.row.operation == "console_restarted" for row in journal.read(kind="device"))
        assert daemon.end() == 0
    assert status(page) == 0


@pytest.mark.nightly
async def test_a_taken_port_costs_the_page_and_nothing_else(tmp_path: Path) -> None:
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        with running_daemon(with_page(tmp_path, other.getsockname()[1]), tmp_path) as daemon:
            assert wait_until(lambda: "console_ended" in daemon.pcmrs("health").stdout, 60.0)
            async with daemon.client() as client:
                await accept(client, "registration.reinit")
