"""The page that a real daemon serves by its own process, as soon as it is opened."""

from __future__ import annotations

import os
import pty
import re
import select
import signal
import socket
import subprocess
import sys
from pathlib import Path
from urllib.error import HTTPError, URLError
from urllib.request import HTTPCookieProcessor, build_opener

import pytest

from pcmrs.console.settings import TOKEN
from pcmrs.journal import JournalReader
from pcmrs.testing.cell import LIGHT
from pcmrs.testing.daemon import free_port
from pcmrs.testing.driving import accept
from tests.system.daemon.daemon_process import (
    PATIENCE,
    START_TIME,
    ServeProcess,
    as_words,
    own_settings,
    running_daemon,
    wait_until,
)


def with_page(folder: Path, port: int) -> list[str]:
    shown = [each for each in own_settings(folder) if not each.startswith("console.")]
    return [*shown, f"console.port={port}", *LIGHT]


def status(url: str) -> int:
    """Of the answer; 0 where nobody answers."""
    try:
        with build_opener(HTTPCookieProcessor()).open(url, timeout=START_TIME) as answer:
            return int(answer.status)
    except HTTPError as error:
        return error.code
    except (URLError, ConnectionError, TimeoutError):  # it is not there yet, or too busy to answer
        return 0


def consoles(daemon: ServeProcess) -> list[int]:
    """Ids of the processes that serve the page."""
    return [pid for pid in daemon.children() if b"console" in Path(f"/proc/{pid}/cmdline").read_bytes()]


def said_until_ready(terminal: int) -> str:
    """Everything that a daemon prints on a terminal until it is ready, or has ended."""
    said = b""

    def complete() -> bool:
        nonlocal said
        if select.select([terminal], [], [], 0.0)[0]:
            try:
                said += os.read(terminal, 4096)
            except OSError:  # it has ended
                return True
        return said.endswith(b"ready\r\n")

    assert wait_until(complete, START_TIME), said.decode()
    return said.decode()


def test_first_start_on_a_terminal_prints_a_link_that_works(tmp_path: Path) -> None:
    ours, theirs = pty.openpty()
    command = [sys.executable, "-m", "pcmrs.cli", "serve", *as_words(with_page(tmp_path, free_port()))]
    with (tmp_path / "log").open("wb") as log:
        daemon = subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=theirs, stderr=log)
    os.close(theirs)
    try:
        said = said_until_ready(ours)
        link = re.search(r"console +(http://\S+\?token=\S+)\r\n", said)
        assert link, said + (tmp_path / "log").read_text()
        assert status(link[1]) == 200, "at once"
    finally:
        daemon.terminate()
        assert daemon.wait(PATIENCE) == 0
        os.close(ours)


def test_page_opens_with_its_token_and_returns_after_a_kill(tmp_path: Path) -> None:
    with running_daemon(with_page(tmp_path, free_port()), tmp_path) as daemon:
        page, token = daemon.ready.console, tmp_path / TOKEN
        assert consoles(daemon) == [], "the page has not been opened"
        assert status(page) == 401, "nobody comes in without the token"
        assert token.stat().st_mode & 0o777 == 0o600
        opened = f"{page}/?token={token.read_text()}"
        assert token.read_text() not in (tmp_path / "log").read_text()
        (killed,) = consoles(daemon)
        os.kill(killed, signal.SIGKILL)
        assert wait_until(lambda: status(opened) == 200, 60.0), "the same address opens it again"
        with JournalReader(Path(daemon.ready.journal)) as journal:
            assert any(row.row.operation == "console_restarted" for row in journal.read(kind="device"))
        assert daemon.end() == 0
    assert status(page) == 0


def test_page_opens_without_the_fork_server(tmp_path: Path) -> None:
    with running_daemon(with_page(tmp_path, free_port()), tmp_path) as daemon:
        os.kill(daemon.fork_server(), signal.SIGKILL)
        assert status(f"{daemon.ready.console}/?token={(tmp_path / TOKEN).read_text()}") == 200
        assert daemon.end() == 0


@pytest.mark.nightly
async def test_a_taken_port_costs_the_page_and_nothing_else(tmp_path: Path) -> None:
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        with running_daemon(with_page(tmp_path, other.getsockname()[1]), tmp_path) as daemon:
            assert daemon.ready.console == ""
            assert wait_until(lambda: "console_ended" in daemon.pcmrs("health").stdout, 60.0)
            async with daemon.client() as client:
                await accept(client, "registration.reinit")
