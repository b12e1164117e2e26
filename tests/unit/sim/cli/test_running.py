"""A simulated world that serves virtual devices for a while."""

import asyncio
import io
import json
import signal
import sys
from collections.abc import AsyncIterator, Iterator
from contextlib import asynccontextmanager
from pathlib import Path

import pytest

from pcmrs.errors import ConfigurationError, DeviceError
from pcmrs_sim.cell import CellSimulation
from pcmrs_sim.cli.running import Address, serve

SETTINGS = {"sim": {"arm": {"physics": "kinematic"}}, "robot": {"driver": "kst"}}


@pytest.fixture(autouse=True)
def _no_terminal(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Without lines, and without a trace of what the command does to its process."""
    monkeypatch.setattr(sys, "stdin", io.StringIO(""))
    before = signal.getsignal(signal.SIGTTIN)
    yield
    signal.signal(signal.SIGTTIN, before)


class Server:
    """A virtual device that remembers how its cell looked at its end."""

    def __init__(self, address: Address) -> None:
        self.address = address
        self.drives_off: str | None = None
        self.ended = False

    @asynccontextmanager
    async def __call__(self, cell: CellSimulation) -> AsyncIterator[Address]:
        try:
            yield self.address
        finally:
            self.drives_off, self.ended = cell.robot_faults.drives_off, True


@asynccontextmanager
async def taken(_cell: CellSimulation) -> AsyncIterator[Address]:
    raise OSError(98, "Address already in use")
    yield


async def test_addresses_are_printed_as_text_or_json(capsys: pytest.CaptureFixture[str]) -> None:
    servers = {"kst": Server(("127.0.0.1", 4000)), "ndi": Server("/dev/pts/7")}
    await serve(servers, SETTINGS, None, 0.01, as_json=False)
    assert capsys.readouterr().out == "serving kst on 127.0.0.1:4000, ndi on /dev/pts/7\n"
    await serve(servers, SETTINGS, None, 0.01, as_json=True)
    assert json.loads(capsys.readouterr().out) == {"kst": ["127.0.0.1", 4000], "ndi": "/dev/pts/7"}
    assert all(server.ended for server in servers.values())


async def test_the_schedule_is_followed_until_the_end_of_the_time(tmp_path: Path) -> None:
    schedule = tmp_path / "faults.txt"
    schedule.write_text("0.0 e_stop on\n1000 e_stop off\n", encoding="utf-8")
    server = Server("/dev/pts/7")
    async with asyncio.timeout(60.0):
        await serve({"kst": server}, SETTINGS, schedule, 0.2, as_json=True)
    assert server.drives_off == "e_stop"


async def test_a_device_that_cannot_listen_ends_the_others(capsys: pytest.CaptureFixture[str]) -> None:
    first = Server(("127.0.0.1", 4000))
    with pytest.raises(DeviceError, match=r"The virtual ndi cannot listen: Address already in use\.") as refused:
        await serve({"kst": first, "ndi": taken}, SETTINGS, None, 1.0, as_json=True)
    assert refused.value.fields == {"device": "ndi"}
    assert first.ended
    assert capsys.readouterr().out == ""


async def test_a_wrong_schedule_is_refused_before_anything_is_served(tmp_path: Path) -> None:
    schedule = tmp_path / "faults.txt"
    schedule.write_text("0.0 e_stopp on\n", encoding="utf-8")
    server = Server("/dev/pts/7")
    with pytest.raises(ConfigurationError, match="line 1"):
        await serve({"kst": server}, SETTINGS, schedule, 1.0, as_json=True)
    assert not server.ended
