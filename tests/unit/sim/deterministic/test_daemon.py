"""Runs of the daemon in simulated time: what a crash loses, what an orderly end writes, and what is lost meanwhile."""

from __future__ import annotations

from pathlib import Path

from pcmrs.journal import JournalReader
from pcmrs.testing.driving import landmarks, tool_pose
from pcmrs.testing.simulated import CellInSimulatedTime
from pcmrs_sim.deterministic.cell import SimulatedCell
from pcmrs_sim.deterministic.daemon import ProcedureDispatcher
from tests.unit.sim.deterministic.simulated_cells import connect, in_cell

PLANNER = 5000
"""UDP port of a planner."""


def rows(folder: Path) -> list[str]:
    """Rows of the cell's journal, in order."""
    with JournalReader(folder / "journal.sqlite") as journal:
        return [str(row) for row in journal.read_whole()]


def test_each_run_is_observed_before_its_first_decision(tmp_path: Path) -> None:
    decided: list[list[str | None]] = []
    robots: list[str] = []

    def observe(dispatcher: ProcedureDispatcher, journal: JournalReader) -> None:
        decided.append([row.row.operation for row in journal.read_whole() if row.row.kind == "outcome"])
        robots.append(dispatcher.snapshot().branches["robot"])

    async def play(cell: SimulatedCell, client: CellInSimulatedTime) -> None:
        await connect(client)
        await client.crash()
        assert robots == ["0", "0"]
        assert decided[0] == []
        assert "connect" in decided[1], "the journal of the run before"

    in_cell(play, tmp_path, observe=observe)


def test_a_crash_ends_the_daemon_at_once_and_keeps_the_journal(tmp_path: Path) -> None:
    async def play(cell: SimulatedCell, client: CellInSimulatedTime) -> None:
        await connect(client)
        daemon = cell.daemon
        assert daemon is not None
        await client.clock.sleep(1.0)
        start, before = client.clock.monotonic(), rows(tmp_path)
        await cell.crash_daemon()
        assert client.clock.monotonic() - start < 0.1
        assert rows(tmp_path) == before, "nothing is written after SIGKILL"
        await cell.start_daemon()
        assert cell.daemon is not daemon
        assert client.snapshot.branches["robot"] == "0", "the robot must be connected again"
        assert rows(tmp_path)[: len(before)] == before

    in_cell(play, tmp_path)


def test_an_orderly_end_holds_the_arm(tmp_path: Path) -> None:
    async def play(cell: SimulatedCell, client: CellInSimulatedTime) -> None:
        await connect(client)
        await cell.end_daemon()
        state = await cell.devices["robot"].joints()
        assert not state.moving
        await cell.start_daemon()
        await connect(client)

    in_cell(play, tmp_path)


def test_datagrams_to_a_daemon_that_has_crashed_are_lost(tmp_path: Path) -> None:
    answers: list[str] = []

    async def play(cell: SimulatedCell, client: CellInSimulatedTime) -> None:
        daemon = cell.daemon
        assert daemon is not None
        planner = cell.network.endpoint("planner")
        planner.send(daemon.link, daemon.receive, PLANNER, b"get_jnt_angsxxxx_#1;", answers.append, None)
        await client.clock.sleep(1.0)
        assert [answer.partition("_")[0] for answer in answers] == ["1"]
        await cell.crash_daemon()
        planner.send(daemon.link, daemon.receive, PLANNER, b"get_jnt_angsxxxx_#2;", answers.append, None)
        await client.clock.sleep(1.0)
        assert len(answers) == 1

    in_cell(play, tmp_path)


def test_a_motion_that_arrived_long_ago_is_refused(tmp_path: Path) -> None:
    async def play(cell: SimulatedCell, client: CellInSimulatedTime) -> None:
        await connect(client)
        await client.accept("registration.plan_landmarks", **landmarks())
        await client.accept("digitization.digitize_all")
        await client.accept("registration.register")
        await client.accept("toolplan.plan", **tool_pose())
        cell.hold_up("daemon", 0.3)
        verdict = await client.call("placement.approach")
        assert verdict.reason is not None
        assert verdict.reason.code == "expired", "it waited for the blocked loop"
        await client.accept("placement.approach")

    in_cell(play, tmp_path)
