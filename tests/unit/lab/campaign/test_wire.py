"""A node behind an impaired link dials the link, never the daemon itself, and ends with its cell."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Sequence
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import pytest

from pcmrs.errors import DeviceError
from pcmrs.testing.loop import run_on_simulated_loop
from pcmrs_lab.campaign import wire
from pcmrs_lab.campaign.network_impairment import InjectedImpairment
from pcmrs_lab.campaign.outside import WITHOUT_NODES
from pcmrs_lab.campaign.wire import remote_cell
from tests.unit.lab.campaign.scripted_cell import ScriptedCell, ScriptedLab


class Remote:
    """The other side of the link.

    Attributes:
        refusals: Number of connections that fail before the daemon listens.
        happened: What happened, in order.
    """

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.refusals = 0
        self.happened: list[str] = []
        self.settings: Sequence[str] = ()
        monkeypatch.setattr(wire, "tcp_proxy", self._proxy)
        monkeypatch.setattr(wire, "outside_node", self._node)
        monkeypatch.setattr("asyncio.open_connection", self._dial)

    @asynccontextmanager
    async def _proxy(self, server: tuple[str, int], impairment: InjectedImpairment) -> AsyncIterator[tuple[str, int]]:
        try:
            yield "127.0.0.2", 4000
        finally:
            assert (impairment.rate, impairment.towards, impairment.back) == (None, True, True), "it is whole again"
            self.happened.append("link ended")

    @asynccontextmanager
    async def _node(self, settings: Sequence[str], log: Path) -> AsyncIterator[Any]:
        self.settings = settings
        self.happened.append("node started")
        try:
            yield self
        finally:
            self.happened.append("node ended")

    async def wait(self) -> None:
        await asyncio.Event().wait()

    async def _dial(self, host: str, port: int) -> tuple[None, Any]:
        self.refusals -= 1
        if self.refusals >= 0:
            raise ConnectionRefusedError
        return None, self

    def close(self) -> None:
        self.happened.append("daemon listens")


@pytest.fixture
def remote(monkeypatch: pytest.MonkeyPatch) -> Remote:
    return Remote(monkeypatch)


def test_the_node_dials_the_link_once_the_daemon_listens(remote: Remote, tmp_path: Path) -> None:
    remote.refusals = 3
    lab = ScriptedLab(tmp_path, ScriptedCell())
    impairment = InjectedImpairment(rate=1000.0)

    async def use() -> None:
        async with remote_cell(lab.as_lab, impairment):
            await asyncio.sleep(5.0)
            impairment.towards = impairment.back = False

    run_on_simulated_loop(use())
    assert remote.happened == ["daemon listens", "node started", "node ended", "link ended"]
    assert "cell.endpoint=tcp/127.0.0.2:4000" in remote.settings
    (settings,) = lab.started
    assert set(WITHOUT_NODES) <= set(settings)
    assert not any("4000" in each for each in settings)
    assert any(each.startswith("access.device_key=") for each in remote.settings)
    assert list((tmp_path / "remote").iterdir())


def test_a_cell_that_fails_leaves_no_node(remote: Remote, tmp_path: Path) -> None:
    async def fail() -> None:
        async with remote_cell(ScriptedLab(tmp_path, ScriptedCell()).as_lab, InjectedImpairment()):
            await asyncio.sleep(1.0)
            raise DeviceError("The daemon is gone.")

    with pytest.raises(DeviceError):
        run_on_simulated_loop(fail())
    assert remote.happened[-2:] == ["node ended", "link ended"]
