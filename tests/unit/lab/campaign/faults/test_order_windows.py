"""Rows in which something meets a slow disk, link or loop: what must not have happened in between is looked for."""

from __future__ import annotations

import asyncio
import signal
from pathlib import Path
from typing import Any

import pytest
from msgspec.structs import replace

from pcmrs.messages import DeviceReply, Reason
from pcmrs.planner import PlannerVerdict
from pcmrs.testing.errors import Unmet
from pcmrs_lab.campaign.delays import Rule
from pcmrs_lab.campaign.fault import NotRun
from pcmrs_lab.campaign.faults import order_windows
from pcmrs_lab.campaign.faults.order_requests import ROBOT
from pcmrs_lab.campaign.sham import sham
from tests.unit.lab.campaign.faults.operated import OperatedCell, lab_of, proves, run
from tests.unit.lab.campaign.faults.test_order_requests import ScriptedDelays
from tests.unit.lab.scripted_client import rejected, row


@pytest.fixture
def delays(monkeypatch: pytest.MonkeyPatch) -> ScriptedDelays:
    made = ScriptedDelays()
    monkeypatch.setattr(order_windows, "delays_of", lambda _: made)
    return made


@pytest.mark.parametrize(
    ("answer", "number"),
    [(b"0.75", True), (b"12;", True), (b"ack", False), (b"", False), (b"1_accepted", False), (b"nan", False)],
)
def test_a_result_is_a_number(answer: bytes, number: bool) -> None:
    assert order_windows._is_number(answer) is number


async def test_writing_begins_when_a_row_is_about_to_be_written(delays: ScriptedDelays) -> None:
    async with order_windows.writing(OperatedCell().as_cell, "outcome") as slow:
        pass
    here, disk = delays.rules
    assert replace(here, id="") == replace(Rule("pass", "dispatcher.before_outcome"), id="")
    assert slow == disk
    assert (disk.times, disk.seconds) == (order_windows.OFTEN, order_windows.SLOW)


def queue(cell: OperatedCell, decision: Any = "rejected") -> None:
    """Answers a planner's motions while another one runs."""

    async def command(name: str, *values: Any, timeout: float = 0.0) -> PlannerVerdict:
        if cell.client.running:
            cell.client.rows.append(row("outcome", operation=name, verdict=None))
            return PlannerVerdict(decision, "placement", "retracted", "busy", ())
        return PlannerVerdict("accepted", "placement", "placed", None, ())

    cell.planner.command = command  # type: ignore[method-assign]


def test_motions_that_were_refused_are_not_done_later(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    cell = OperatedCell()
    queue(cell, "accepted")
    with pytest.raises(Unmet, match="They were"):
        run(monkeypatch, order_windows.queued_motions(lab_of(tmp_path, cell)))
    cell = OperatedCell()
    queue(cell)
    with sham():
        found = run(monkeypatch, order_windows.queued_motions(lab_of(tmp_path, cell)))
    assert "rejected_in_the_journal" in found.missing("order")


def test_an_arm_that_is_moved_by_hand_is_held(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    cell = OperatedCell(placement="standoff")

    def guide(_: dict[str, Any]) -> None:
        cell.scene.places = [(0.0, 0.02, 0.0)]
        cell.client.hold("moved_unasked")

    cell.scene.effects["guide_by_hand"] = guide
    found = run(monkeypatch, order_windows.moves_while_nothing_runs(lab_of(tmp_path, cell)))
    assert proves(found)
    assert found.took_place == {"moved_by_hand_mm": 20.0}


def test_an_arm_that_nobody_moved_is_found_out(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    with sham(), pytest.raises(Unmet, match="expected state did not come"):
        run(monkeypatch, order_windows.moves_while_nothing_runs(lab_of(tmp_path, OperatedCell(placement="standoff"))))


def slow_to_hold(cell: OperatedCell, *pending: str) -> None:
    """A Stop waits for these conditions; it cannot be acknowledged until they hold."""
    hold = cell.client.hold

    def begin(code: str = "", *, danger: bool = True) -> None:
        hold(code, danger=danger)
        cell.client.stop_state = replace(cell.client.stop_state, pending=pending)

    cell.client.hold = begin  # type: ignore[method-assign]
    cell.client.refuses["robot.acknowledge"] = lambda _: "stop_pending" if cell.client.stop_state.pending else ""


def stands(cell: OperatedCell) -> None:
    cell.client.stop_state = replace(cell.client.stop_state, pending=())


def test_a_stop_is_pending_until_the_arm_stands(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, delays: ScriptedDelays
) -> None:
    cell = OperatedCell()
    slow_to_hold(cell, "standstill")
    delays.arrives = lambda: stands(cell)
    found = run(monkeypatch, order_windows.hold_late(lab_of(tmp_path, cell)))
    assert proves(found)
    assert "stop_pending" in found.response


def test_a_stop_that_waits_for_nothing_is_unmet(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, delays: ScriptedDelays
) -> None:
    cell = OperatedCell()
    slow_to_hold(cell, "force_limit")
    delays.arrives = lambda: stands(cell)
    with pytest.raises(Unmet, match="not for standstill"):
        run(monkeypatch, order_windows.hold_late(lab_of(tmp_path, cell)))


def test_a_beat_that_nothing_overtook_proves_nothing(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, delays: ScriptedDelays
) -> None:
    assert proves(run(monkeypatch, order_windows.beats_out_of_order(lab_of(tmp_path, OperatedCell()))))
    delays.overtaken = 0
    with pytest.raises(Unmet, match="No beat has overtaken"):
        run(monkeypatch, order_windows.beats_out_of_order(lab_of(tmp_path, OperatedCell())))


@pytest.mark.parametrize(
    ("injection", "name"),
    [
        (order_windows.plan_cleared, "toolplan.clear"),
        (order_windows.registration_cleared, "registration.clear_registration"),
    ],
)
def test_there_is_no_standoff_of_another_plan(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, delays: ScriptedDelays, injection: Any, name: str
) -> None:
    cell = OperatedCell(placement="placed")
    with pytest.raises(Unmet, match="The tool is at a standoff of another plan"):
        run(monkeypatch, injection(lab_of(tmp_path, cell)))
    cell = OperatedCell(placement="placed")
    cell.client.refuses[name] = "busy"
    found = run(monkeypatch, injection(lab_of(tmp_path, cell)))
    assert found.response == f"{name}: rejected, placement standoff"
    assert proves(found)


def test_a_daemon_without_a_planning_process_is_not_run(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(order_windows, "_planning_processes", lambda _: [])
    with pytest.raises(NotRun, match="No process plans motions"):
        run(monkeypatch, order_windows.plan_out_of_date(lab_of(tmp_path, OperatedCell())))


def test_a_process_that_still_plans_proves_nothing(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    sent: list[int] = []
    monkeypatch.setattr(order_windows, "_planning_processes", lambda _: [7])
    monkeypatch.setattr(order_windows, "process_state", lambda _: "S")
    monkeypatch.setattr("os.kill", lambda _pid, number: sent.append(number))
    cell = OperatedCell()
    cell.client.answers["placement.approach"] = [rejected("plan_outdated")]
    with pytest.raises(Unmet, match="not stopped: its state is S"):
        run(monkeypatch, order_windows.plan_out_of_date(lab_of(tmp_path, cell)))
    assert sent == [signal.SIGSTOP, signal.SIGCONT], "it is never left stopped"
    cell.client.answers["placement.approach"] = [rejected("plan_outdated")]
    with sham(), pytest.raises(Unmet, match="not stopped"):
        run(monkeypatch, order_windows.plan_out_of_date(lab_of(tmp_path, cell)))
    assert sent[2:] == [signal.SIGCONT]


def test_a_plan_that_comes_after_a_stop_begins_nothing(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    cell, sent = OperatedCell(), list[int]()
    call, asked = cell.client.call, list[str]()

    async def plan(name: str, arguments: Any = None, **more: Any) -> Any:
        asked.append(name)
        if asked.count("placement.approach") == 1 and name == "placement.approach":
            while signal.SIGCONT not in sent:  # noqa: ASYNC110 - it is planned by a process that is stopped
                await asyncio.sleep(0.1)
            cell.client.answers[name] = [rejected("plan_outdated")]
        return await call(name, arguments, **more)

    monkeypatch.setattr(order_windows, "_planning_processes", lambda _: [7])
    monkeypatch.setattr(order_windows, "process_state", lambda _: "T")
    monkeypatch.setattr("os.kill", lambda _pid, number: sent.append(number))
    monkeypatch.setattr(cell.client, "call", plan)
    found = run(monkeypatch, order_windows.plan_out_of_date(lab_of(tmp_path, cell)))
    assert proves(found)
    assert found.response == "rejected: plan_outdated: It is plan_outdated."


@pytest.mark.parametrize("command", [b"python\0-m\0pcmrs.planning_process\0", b"python\0-m\0pcmrs.cli\0node\0"])
def test_the_planning_process_is_found_by_its_command(monkeypatch: pytest.MonkeyPatch, command: bytes) -> None:
    monkeypatch.setattr(order_windows, "descendants", lambda _: [7])
    monkeypatch.setattr(Path, "read_bytes", lambda _: command)
    found = order_windows._planning_processes(OperatedCell().as_cell)
    assert found == ([7] if b"planning_process" in command else [])


async def test_a_node_says_why_it_refuses() -> None:
    cell = OperatedCell()
    token: Any = None
    stale = Reason(code="request_refused", text="It is stale.", fields={"code": "stale_request"})
    cell.bus.answers[ROBOT] = DeviceReply(failure=stale)
    assert await order_windows._refusal(cell.as_cell, token, {}) == "stale_request"
    cell.bus.answers[ROBOT] = DeviceReply(failure=Reason(code="busy", text="Busy."))
    assert await order_windows._refusal(cell.as_cell, token, {}) == "busy"
    cell.bus.answers[ROBOT] = DeviceReply(result={"outcome": "done"})
    assert await order_windows._refusal(cell.as_cell, token, {}) is None
