"""The processes of a cell in simulated time: they start, stall, crash and start again."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from pcmrs.errors import UnknownOutcomeError
from pcmrs.messages import Command, Verdict
from pcmrs.testing.simulated import CellInSimulatedTime
from pcmrs_sim.deterministic.cell import DAEMON, SimulatedCell
from tests.unit.sim.deterministic.simulated_cells import connect, in_cell


def test_starting_what_runs_changes_nothing(tmp_path: Path) -> None:
    async def play(cell: SimulatedCell, client: CellInSimulatedTime) -> None:
        await connect(client)
        daemon, sequence = cell.daemon, client.snapshot.sequence
        await cell.start_daemon()
        cell.start_node()
        await client.clock.sleep(1.0)
        assert cell.daemon is daemon
        assert client.snapshot.sequence == sequence

    in_cell(play, tmp_path)


def test_a_crashed_node_is_noticed_and_can_be_started_again(tmp_path: Path) -> None:
    async def play(cell: SimulatedCell, client: CellInSimulatedTime) -> None:
        await connect(client)
        assert client.snapshot.branches["robot"] == "1"
        await cell.crash_node()
        await client.until(lambda shown: shown.branches["robot"] == "0", within=0.05)
        assert (await client.call("robot.connect")).decision != "accepted"
        cell.start_node()
        await client.clock.sleep(5.0)
        await client.accept("robot.connect")

    in_cell(play, tmp_path)


def test_while_no_daemon_runs_commands_have_an_unknown_outcome(tmp_path: Path) -> None:
    async def play(cell: SimulatedCell, client: CellInSimulatedTime) -> None:
        await cell.crash_daemon()
        assert cell.daemon is None
        await cell.crash_daemon()  # there is none: nothing happens
        anna = cell.network.endpoint("anna")
        command = Command(id="1", branch="robot", operation="connect", source="bus:anna", arguments={}, sent=0.0)
        with pytest.raises(UnknownOutcomeError):
            await anna.request("cmd/anna/robot/connect", command, Verdict, 1.0)
        await cell.start_daemon()
        await connect(client)

    in_cell(play, tmp_path)


def test_a_stalled_daemon_answers_when_it_goes_on(tmp_path: Path) -> None:
    async def play(cell: SimulatedCell, client: CellInSimulatedTime) -> None:
        await connect(client)
        start = client.clock.monotonic()
        cell.hold_up(DAEMON, 0.2)
        await client.call("registration.clear_registration")
        assert client.clock.monotonic() - start >= 0.2

    in_cell(play, tmp_path)


def test_the_node_serves_the_devices_that_watch_the_opened_ones(tmp_path: Path) -> None:
    calls: list[str] = []

    class WatchedRobot:
        """Reports the connections to a robot."""

        def __init__(self, robot: Any) -> None:
            self._robot = robot

        def __getattr__(self, name: str) -> Any:
            return getattr(self._robot, name)

        async def connect(self) -> Any:
            calls.append("connect")
            return await self._robot.connect()

    async def play(_cell: SimulatedCell, client: CellInSimulatedTime) -> None:
        await connect(client)

    in_cell(play, tmp_path, watched=lambda devices: {**devices, "robot": WatchedRobot(devices["robot"])})
    assert calls == ["connect"]
