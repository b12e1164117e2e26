"""Rows of processes: what was killed where, which version a journal has, and what a new client is told."""

from __future__ import annotations

import os
import signal
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from pcmrs.errors import BusError
from pcmrs.journal import Journal
from pcmrs.testing.errors import Unmet
from pcmrs.testing.journal import row as written
from pcmrs_lab.campaign.faults import process
from pcmrs_lab.campaign.kills import KillReport
from pcmrs_lab.campaign.sham import sham
from tests.unit.lab.campaign.faults.operated import OperatedCell, lab_of, proves, run
from tests.unit.lab.campaign.scripted_cell import ScriptedLab
from tests.unit.lab.campaign.scripted_child import ScriptedChild, started
from tests.unit.lab.scripted_client import row

PLACES = ("journal.before_commit", "journal.after_commit")


def killed(**changed: Any) -> KillReport:
    given: dict[str, Any] = {
        "at": dict.fromkeys(PLACES, 2),
        "not_reached": {},
        "acknowledged": 9,
        "lost": 0,
        "refused": [],
    }
    return KillReport(what="a process", kills=4, seed=1, seconds=1.0, **(given | changed))


def test_killed_processes_have_lost_nothing() -> None:
    found = process._nothing_lost(killed(), "row", PLACES)
    assert proves(found)
    assert found.took_place == {f"killed at {name}": 2 for name in PLACES}
    assert not proves(process._nothing_lost(killed(acknowledged=0), "row", PLACES)), "nothing was there to lose"


@pytest.mark.parametrize(
    ("changed", "text"),
    [
        ({"lost": 1}, "1 acknowledged rows are lost"),
        ({"refused": ["The journal is damaged."]}, "damaged"),
        ({"at": {PLACES[0]: 2}}, f"Nothing was killed at {PLACES[1]}"),
        ({"at": {}, "not_reached": dict.fromkeys(PLACES, 1)}, "not reached in time"),
    ],
)
def test_a_loss_or_a_failpoint_that_is_not_reached_is_unmet(changed: dict[str, Any], text: str) -> None:
    with pytest.raises(Unmet, match=text):
        process._nothing_lost(killed(**changed), "row", PLACES)


async def test_the_version_of_a_journal_is_read_and_changed(tmp_path: Path) -> None:
    journal = Journal.open(tmp_path / "ratms.sqlite")
    await journal.append([written("run0", 0, 1)])
    await journal.close()
    before = process._version(tmp_path / "ratms.sqlite")
    assert before > 1
    assert process._version(tmp_path / "ratms.sqlite", process.UNKNOWN) == process.UNKNOWN
    assert process._version(tmp_path / "ratms.sqlite") == process.UNKNOWN


def test_a_process_is_one_of_ours_while_it_runs(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Path, "read_bytes", lambda _: b"python\0-m\0pcmrs.cli\0")
    assert process._is_running(os.getpid())
    monkeypatch.setattr(Path, "read_bytes", lambda _: b"vim\0")
    assert not process._is_running(os.getpid()), "its id belongs to another one now"
    monkeypatch.undo()
    assert not process._is_running(1 << 30)


async def test_a_new_client_is_told_why_it_is_not_admitted(monkeypatch: pytest.MonkeyPatch) -> None:
    admitted = [True]

    @asynccontextmanager
    async def connect(endpoint: str, *, cell: str) -> AsyncIterator[Any]:
        if not admitted[0]:
            raise BusError(f"No daemon answers at {endpoint}.")
        yield OperatedCell().client

    monkeypatch.setattr("pcmrs.client.Client.connect", connect)
    cell = OperatedCell()
    assert await process._connect_new_client(cell.as_cell) == process.CONNECTED
    admitted[0] = False
    assert await process._connect_new_client(cell.as_cell) == "No daemon answers at tcp/127.0.0.1:9."


def test_a_task_is_made_to_fail_when_it_waits(monkeypatch: pytest.MonkeyPatch) -> None:
    answers = ["no such task", "no such task", "failed"]
    orders: list[str] = []

    async def order(_: Path, text: str) -> str:
        orders.append(text)
        return answers.pop(0) if answers[1:] else answers[0]

    monkeypatch.setattr(process, "order", order)
    run(monkeypatch, process._make_task_fail(Path("orders"), "watch"))
    assert orders == ["fail watch"] * 3
    answers[:] = ["no such task"]
    with pytest.raises(Unmet, match="Nothing made the task watch fail"):
        run(monkeypatch, process._make_task_fail(Path("orders"), "watch"))


@pytest.mark.parametrize("blocks", [True, False])
async def test_a_subscriber_is_blocked_or_hears_more(monkeypatch: pytest.MonkeyPatch, blocks: bool) -> None:
    child = ScriptedChild(b"heard\n" if blocks else b"heard\nheard\nheard\n")
    started(monkeypatch, child)
    async with process._blocked_subscriber(OperatedCell().as_cell, blocks=blocks) as messages:
        assert await messages() == (1 if blocks else 3)
        if not blocks:
            assert await messages(more=True) == 3
    assert child.words[-1] == ("blocks" if blocks else "returns")
    assert child.signals == [signal.SIGKILL]


async def test_a_subscriber_that_has_ended_blocks_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    child = ScriptedChild(b"heard\n")
    started(monkeypatch, child)
    async with process._blocked_subscriber(OperatedCell().as_cell) as messages:
        child.returncode = 1
        with pytest.raises(Unmet, match="has ended"):
            await messages()


async def test_a_sham_subscriber_returns(monkeypatch: pytest.MonkeyPatch) -> None:
    child = ScriptedChild(b"heard\n")
    started(monkeypatch, child)
    with sham():
        async with process._blocked_subscriber(OperatedCell().as_cell):
            pass
    assert child.words[-1] == "returns"


class Refused(ScriptedLab):
    """A lab whose second daemons are refused."""

    def __init__(self, folder: Path, *refusals: tuple[int, str]) -> None:
        super().__init__(folder, OperatedCell())
        self.refusals = list(refusals)


FOLDER, BUS = (4, "Another daemon runs this cell."), (3, "On the bus another daemon is there.")


@pytest.mark.parametrize("refusals", [[FOLDER, BUS]])
def test_a_second_daemon_is_refused_on_folder_and_bus(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, refusals: list[tuple[int, str]]
) -> None:
    found = run(monkeypatch, process.a_second_daemon(Refused(tmp_path, *refusals).as_lab))
    assert proves(found)
    assert found.took_place == {"on_the_folder_exit_status": 4, "on_the_bus_exit_status": 3}


@pytest.mark.parametrize("refusals", [[(4, "Disk full."), BUS], [(0, ""), BUS], [FOLDER, (4, BUS[1])]])
def test_a_second_daemon_refused_for_something_else_is_unmet(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, refusals: list[tuple[int, str]]
) -> None:
    with pytest.raises(Unmet, match="Exit status"):
        run(monkeypatch, process.a_second_daemon(Refused(tmp_path, *refusals).as_lab))


WRONG = ("no_such_arm", "rate", "no_such_key", "no_such_driver", "port", "workflow.toml")


def test_wrong_settings_are_refused_by_name(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    lab = Refused(tmp_path, *((4, f"Error: {word} is wrong.") for word in WRONG))
    found = run(monkeypatch, process.bad_configuration(lab.as_lab))
    assert proves(found)
    assert set(found.took_place.values()) == {4}
    assert len(lab.started) == 1 + len(WRONG)


@pytest.mark.parametrize(
    ("refusal", "text"),
    [
        ((2, "no_such_arm"), "exit status 2"),
        ((4, "something"), "something"),
        ((4, "Traceback: no_such_arm"), "Traceback"),
    ],
)
def test_a_setting_that_is_refused_otherwise_is_unmet(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, refusal: tuple[int, str], text: str
) -> None:
    with pytest.raises(Unmet, match=text):
        run(monkeypatch, process.bad_configuration(Refused(tmp_path, refusal).as_lab))


def test_a_refused_daemon_leaves_no_journal(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    (tmp_path / "wrong0").mkdir()
    (tmp_path / "wrong0" / "ratms.sqlite").write_bytes(b"")
    with pytest.raises(Unmet, match="a journal was created"):
        run(monkeypatch, process.bad_configuration(Refused(tmp_path, (4, "no_such_arm")).as_lab))


def stopped(cell: OperatedCell, monkeypatch: pytest.MonkeyPatch, state: str = "T") -> None:
    """A daemon that is stopped by a signal: its node holds the arm."""
    send = cell.process.send_signal

    def signalled(number: int) -> None:
        send(number)
        if number == signal.SIGSTOP:
            cell.client.hold()
            cell.log = "held_by_node"

    monkeypatch.setattr(cell.process, "send_signal", signalled)
    monkeypatch.setattr(process, "process_state", lambda _: state)


def test_a_stopped_daemon_is_held_by_the_node(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    cell = OperatedCell()
    stopped(cell, monkeypatch)
    found = run(monkeypatch, process.the_daemon_is_stopped(lab_of(tmp_path, cell)))
    assert found.took_place["stopped"] is True
    assert found.control == {"approach": "accepted", "reached": "standoff"}
    assert cell.process.signals == [signal.SIGSTOP, signal.SIGCONT]


def test_a_daemon_that_was_not_stopped_proves_nothing(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    cell = OperatedCell()
    stopped(cell, monkeypatch, state="S")
    assert "stopped" in run(monkeypatch, process.the_daemon_is_stopped(lab_of(tmp_path, cell))).missing("order")
    cell = OperatedCell()
    stopped(cell, monkeypatch)
    with sham(), pytest.raises(Unmet, match="does not contain 'held_by_node'"):
        run(monkeypatch, process.the_daemon_is_stopped(lab_of(tmp_path, cell)))
    assert cell.process.signals == [signal.SIGCONT], "it is always continued"


def test_a_task_that_dies_is_reported(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    cell = OperatedCell()
    tasks = [SimpleNamespace(name=process.TASK, restarts=1)]

    async def order(*_: Any) -> str:
        cell.log = "task_died"
        cell.client.rows.append(row("device", operation="task_restarted"))
        return "failed"

    async def health() -> Any:
        return SimpleNamespace(tasks=tasks)

    monkeypatch.setattr(process, "order", order)
    monkeypatch.setattr(cell.client, "health", health)
    assert proves(run(monkeypatch, process.a_task_dies(lab_of(tmp_path, cell))))
    tasks[0].restarts = 0
    assert "restarts" in run(monkeypatch, process.a_task_dies(lab_of(tmp_path, cell))).missing("order")


def test_a_restart_without_a_row_is_unmet(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    cell = OperatedCell()

    async def order(*_: Any) -> str:
        cell.log = "task_died"
        return "failed"

    monkeypatch.setattr(process, "order", order)
    with pytest.raises(Unmet, match="The journal has no row of the restart"):
        run(monkeypatch, process.a_task_dies(lab_of(tmp_path, cell)))
