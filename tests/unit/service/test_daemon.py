"""A daemon that cannot run its cell says why, before anything is opened, and leaves the cell to others."""

from __future__ import annotations

import asyncio
import fcntl
import socket
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path

import pytest
from structlog.testing import capture_logs

from pcmrs.authoring.design import design
from pcmrs.errors import BlueprintError, BusError, ConfigurationError
from pcmrs.service import _daemon as daemon_module
from pcmrs.service._daemon import Daemon, keep_real_time_policy
from pcmrs.settings import CellSettings, Settings
from pcmrs.testing.clock import ManualClock, settle
from tests.unit.authoring.design.step_tables import step, table


def cell(folder: Path, port: int = 0) -> Settings:
    return Settings(cell=CellSettings(folder=str(folder), endpoint=f"tcp/127.0.0.1:{port}"))


async def start(settings: Settings) -> None:
    async with Daemon(settings).running():
        pytest.fail("It runs.")


def files(folder: Path) -> list[str]:
    return [file.name for file in folder.iterdir()]


@contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Another daemon runs the cell."""
    with (folder / "lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        yield


async def test_second_daemon_of_a_cell_is_refused(tmp_path: Path) -> None:
    with locked(tmp_path), pytest.raises(ConfigurationError, match="Another daemon runs this cell") as raised:
        await start(cell(tmp_path))
    assert raised.value.fields == {"folder": str(tmp_path)}
    assert files(tmp_path) == ["lock"], "the journal of the other one is not touched"


async def test_folder_that_cannot_be_used_is_named(tmp_path: Path) -> None:
    (tmp_path / "cell").write_text("not a folder")
    with pytest.raises(ConfigurationError, match="cannot be used"):
        await start(cell(tmp_path / "cell"))


async def test_unknown_workflow_opens_nothing(tmp_path: Path) -> None:
    with pytest.raises((ConfigurationError, BlueprintError), match="no_such_workflow"):
        await start(Settings(workflow="no_such_workflow", cell=CellSettings(folder=str(tmp_path / "cell"))))
    assert not (tmp_path / "cell").exists()


ORIGIN = {"model": "made", "prompt": "ab", "protocol": "cd", "date": "2026-11-27"}


async def test_a_draft_without_approval_opens_nothing(tmp_path: Path) -> None:
    file = tmp_path / "drafted.toml"
    file.write_text(design(table(step("a"), provenance=ORIGIN)).text)
    with pytest.raises(ConfigurationError, match="a language model has drafted demo, and it cannot be started"):
        await start(Settings(workflow=str(file), cell=CellSettings(folder=str(tmp_path / "cell"))))
    assert not (tmp_path / "cell").exists()


async def test_taken_endpoint_ends_the_start_and_frees_the_cell(tmp_path: Path) -> None:
    with closing(socket.create_server(("127.0.0.1", 0))) as taken, pytest.raises(BusError):
        await start(cell(tmp_path, taken.getsockname()[1]))
    with locked(tmp_path):
        assert sorted(files(tmp_path)) == ["cell.json", "lock"], "there is no journal yet"


class Forbidden:
    """A real-time policy that the machine does not permit."""

    def __init__(self) -> None:
        self.kept = False

    def give(self) -> None:
        raise PermissionError

    async def keep(self, _sleep: object) -> None:
        self.kept = True
        await asyncio.Event().wait()


async def test_daemon_without_real_time_permission_works_on(monkeypatch: pytest.MonkeyPatch) -> None:
    made: list[Forbidden] = []

    def forbidden(_priority: object) -> Forbidden:
        made.append(Forbidden())
        return made[-1]

    monkeypatch.setattr(daemon_module, "RealTime", forbidden)
    monkeypatch.setattr(daemon_module, "keep_pauses_short", lambda: None)
    with capture_logs() as logs:
        going = asyncio.create_task(keep_real_time_policy(ManualClock()))
        await settle()
    assert [each["event"] for each in logs] == ["no_real_time_policy"]
    assert made[0].kept, "threads that start later are looked after all the same"
    assert not going.done()
    going.cancel()
    await asyncio.gather(going, return_exceptions=True)
