"""Rows of uploads: what the console must refuse, and a file that a killed console has left."""

from __future__ import annotations

import asyncio
import signal
from collections.abc import AsyncIterator, Callable, Sequence
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any, cast

import pytest

from pcmrs.testing.errors import Unmet
from pcmrs_lab.campaign.consoles import RunningConsole
from pcmrs_lab.campaign.faults import uploads
from pcmrs_lab.campaign.faults.uploads import LENGTH_REQUIRED, LIMIT, TOO_LARGE, UPLOADS
from pcmrs_lab.campaign.sham import sham
from pcmrs_lab.campaign.uploading import TAKEN, Uploader
from tests.unit.lab.campaign.faults.operated import OperatedCell, lab_of, proves, run
from tests.unit.lab.campaign.scripted_cell import ScriptedProcess


class Server:
    """A console, and what it answers to uploads.

    Attributes:
        reads: Called with each sent file.
    """

    def __init__(self, monkeypatch: pytest.MonkeyPatch, folder: Path) -> None:
        self.process = ScriptedProcess()
        self.console = RunningConsole(cast(Any, self.process), 8080, folder / "uploads")
        self.taken = TAKEN
        self.announced = (TOO_LARGE, f"At most {LIMIT} bytes.")
        self.unmeasured = (LENGTH_REQUIRED, "Content-Length is missing.")
        self.reads: Callable[[], None] = lambda: None
        self.starts: Callable[[], None] = lambda: None
        self.sent = 0
        self.unguarded = False
        (folder / "uploads").mkdir()
        monkeypatch.setattr(uploads, "running_console", self._run)
        monkeypatch.setattr(uploads, "uploader", self._uploader)
        monkeypatch.setattr(uploads, "until_true", self._until)
        monkeypatch.setattr(uploads, "process_state", lambda _: "T" if signal.SIGSTOP in self.process.signals else "S")

    @asynccontextmanager
    async def _run(
        self, _cell: Any, _folder: Path, _port: int, prefix: Sequence[str] = ()
    ) -> AsyncIterator[RunningConsole]:
        self.unguarded = bool(prefix)
        self.starts()
        yield self.console

    async def _uploader(self, _: RunningConsole) -> Uploader:
        return cast(Uploader, self)

    async def _until(self, condition: Callable[[], bool], missing: str) -> None:
        if not condition():
            raise Unmet(missing)

    async def send(self, _: bytes) -> int:
        self.sent += 1
        self.reads()
        return self.taken

    async def announce(self, _: int) -> tuple[int, str]:
        if self.unguarded:
            await asyncio.Event().wait()
        return self.announced

    async def send_without_length(self, _: bytes) -> tuple[int, str]:
        return (TAKEN, "") if self.unguarded else self.unmeasured

    @property
    def file(self) -> Path:
        return self.console.uploads / "upload"


@pytest.fixture
def server(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Server:
    return Server(monkeypatch, tmp_path)


def ran(monkeypatch: pytest.MonkeyPatch, folder: Path, row: Any) -> Any:
    return run(monkeypatch, row(lab_of(folder, OperatedCell())))


@pytest.mark.parametrize("row", [uploads.announced_too_long, uploads.without_length])
def test_what_is_too_long_or_endless_is_refused(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, server: Server, row: Any
) -> None:
    assert proves(ran(monkeypatch, tmp_path, row))
    with sham(), pytest.raises(Unmet, match="It was answered 200"):
        ran(monkeypatch, tmp_path, row)
    server.announced = server.unmeasured = (TAKEN, "")
    with pytest.raises(Unmet, match="It was answered 200"):
        ran(monkeypatch, tmp_path, row)
    server.taken = TOO_LARGE
    with pytest.raises(Unmet, match="A short upload was answered 413"):
        ran(monkeypatch, tmp_path, row)


def test_a_refusal_must_name_the_limit(monkeypatch: pytest.MonkeyPatch, tmp_path: Path, server: Server) -> None:
    server.announced = (TOO_LARGE, "Too large.")
    with pytest.raises(Unmet, match="It was answered 413: Too large"):
        ran(monkeypatch, tmp_path, uploads.announced_too_long)


def leaves(server: Server, *, removed: bool = True) -> None:
    """A console that has a file while it reads it; the next one with its guards removes it."""
    started = [0]

    def starts() -> None:
        started[0] += 1
        if started[0] == 3 and removed:
            server.file.unlink()

    server.reads = lambda: cast(None, server.file.write_bytes(uploads.FILE))
    server.starts = starts


def test_a_file_of_a_killed_console_is_removed(monkeypatch: pytest.MonkeyPatch, tmp_path: Path, server: Server) -> None:
    leaves(server)
    found = ran(monkeypatch, tmp_path, uploads.killed_with_a_file)
    assert proves(found)
    assert found.took_place == {"bytes_left_by_the_killed_one": len(uploads.FILE)}
    assert server.process.signals == [signal.SIGSTOP, signal.SIGKILL]


def test_a_file_that_stays_is_unmet(monkeypatch: pytest.MonkeyPatch, tmp_path: Path, server: Server) -> None:
    leaves(server, removed=False)
    with pytest.raises(Unmet, match=r"After the next start there are \['upload'\]"):
        ran(monkeypatch, tmp_path, uploads.killed_with_a_file)


def test_a_console_that_was_not_killed_is_found_out(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, server: Server
) -> None:
    leaves(server)
    with sham(), pytest.raises(Unmet, match="The console has not ended"):
        ran(monkeypatch, tmp_path, uploads.killed_with_a_file)


def test_a_console_is_stopped_while_it_has_a_file(monkeypatch: pytest.MonkeyPatch, server: Server) -> None:
    looks, kept_from = [0], [7]

    def left(_: Any) -> list[Path]:
        looks[0] += 1
        return [server.file] if looks[0] % 2 or looks[0] > kept_from[0] else []

    server.file.write_bytes(uploads.FILE)
    monkeypatch.setattr(uploads, "_left", left)
    run(monkeypatch, uploads._until_stopped_with_a_file(server.console, cast(Uploader, server)))
    assert server.sent == 4, "it had read the file before it was stopped"
    assert server.process.signals[-2:] == [signal.SIGCONT, signal.SIGSTOP]
    looks[0], kept_from[0] = 0, 1000
    with pytest.raises(Unmet, match=f"None of {UPLOADS} files existed any more"):
        run(monkeypatch, uploads._until_stopped_with_a_file(server.console, cast(Uploader, server)))
