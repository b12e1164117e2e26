"""A node that no daemon starts has the devices of its cell, and ends with its context even if it is stopped."""

from __future__ import annotations

import signal
from pathlib import Path

import pytest

from pcmrs_lab.campaign.outside import DEVICES, WITHOUT_NODES, outside_node
from tests.unit.lab.campaign.scripted_child import ScriptedChild, started


async def test_a_node_has_the_devices_that_its_daemon_has_not(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    child = ScriptedChild()
    started(monkeypatch, child)
    async with outside_node((*WITHOUT_NODES, "cell.rate=1"), tmp_path / "log") as node:
        assert node.returncode is None
    assert child.words[3:] == ("node", "sim", *DEVICES, "--set", "cell.rate=1")
    assert child.signals == [signal.SIGCONT, signal.SIGTERM]
    assert (tmp_path / "log").exists()


async def test_a_node_that_has_ended_is_left_alone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    child = ScriptedChild()

    def gone(_: int) -> None:
        child.returncode = 1
        raise ProcessLookupError

    monkeypatch.setattr(child, "send_signal", gone)
    started(monkeypatch, child)
    async with outside_node((), tmp_path / "log"):
        pass
    assert child.returncode == 1
