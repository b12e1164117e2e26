"""Device nodes as child processes: begun anew within limits, then given up."""

from __future__ import annotations

import asyncio
import os
import stat
import sys
from pathlib import Path

import pytest

from pcmrs.bus.seal import new_key
from pcmrs.clock import SystemClock
from pcmrs.messages import DeviceEvent
from pcmrs.processes.starting import start_by_exec
from pcmrs.service.processes.nodes import NodeProcesses
from pcmrs.service.supervisor import RESTARTS, Supervisor
from pcmrs.settings import Settings
from pcmrs.testing.waiting import wait_until


class Bench:
    """Nodes whose program is a script."""

    def __init__(self, folder: Path, monkeypatch: pytest.MonkeyPatch, script: str) -> None:
        program = folder / "program"
        program.write_text(f"#!/bin/sh\necho $$ >> {folder / 'begun'}\n{script}\n")
        program.chmod(program.stat().st_mode | stat.S_IXUSR)
        monkeypatch.setattr(sys, "executable", str(program))
        self.begun_file = folder / "begun"
        self.ended: list[list[str]] = []
        self.events: list[DeviceEvent] = []
        self.worth_a_restart = True
        clock = SystemClock()
        self.supervisor = Supervisor(clock)
        self.nodes = NodeProcesses(Settings(), new_key(), self._end, self._report, clock, start_by_exec)

    def _end(self, devices: list[str]) -> bool:
        self.ended.append(devices)
        return self.worth_a_restart

    def _report(self, event: DeviceEvent) -> None:
        self.events.append(event)

    @property
    def begun(self) -> list[int]:
        return [int(pid) for pid in self.begun_file.read_text().split()] if self.begun_file.exists() else []


async def test_node_that_keeps_ending_is_given_up_as_danger(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The daemon continues."""
    bench = Bench(tmp_path, monkeypatch, "exit 7")
    async with bench.supervisor:
        bench.nodes.start(bench.supervisor)
        await wait_until(lambda: bench.events and bench.events[-1].code == "node_failed")
        await asyncio.sleep(0.1)
    assert [event.code for event in bench.events] == ["node_restarted"] * RESTARTS + ["node_failed"]
    assert [event.danger for event in bench.events] == [False] * RESTARTS + [True]
    assert bench.events[0].fields["status"] == 7
    assert len(bench.begun) == RESTARTS + 1
    assert bench.ended == [Settings().drivers()["sim"]] * (RESTARTS + 1)
    assert bench.nodes.restarts == {"sim": RESTARTS}
    assert bench.nodes.given_up == {"sim"}
    assert bench.supervisor.died == 0


async def test_node_that_ends_during_the_start_is_not_restarted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    bench = Bench(tmp_path, monkeypatch, "exit 1")
    bench.worth_a_restart = False
    async with bench.supervisor:
        bench.nodes.start(bench.supervisor)
        await wait_until(lambda: bench.ended)
        await asyncio.sleep(0.1)
    assert len(bench.begun) == 1
    assert bench.events == []


async def test_stopped_nodes_are_not_restarted(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    bench = Bench(tmp_path, monkeypatch, "exec sleep 60")
    async with bench.supervisor:
        bench.nodes.start(bench.supervisor)
        await wait_until(lambda: bench.begun)
    await bench.nodes.stop()
    (pid,) = bench.begun
    with pytest.raises(ProcessLookupError):
        os.kill(pid, 0)
    assert bench.ended == []
