"""Operators send each command under an id of its own, repeat it under the same, and believe only answers to it."""

from __future__ import annotations

import asyncio
from typing import Any

import pytest

from pcmrs.testing.loop import run_on_simulated_loop
from pcmrs_lab.campaign.explore.operators import OLD_PORT, PATIENCE, PORTS, REPEAT_AFTER, Operators
from tests.unit.lab.campaign.explore.ratms_views import decided, shown
from tests.unit.lab.campaign.explore.scripted_session import ScriptedCell, witness


class People:
    """Operators of a scripted cell, and the verdicts that reached them."""

    def __init__(self) -> None:
        self.cell = ScriptedCell()
        self.verdicts: list[str] = []
        self.witness = witness()
        self.operators = Operators(
            self.cell.as_cell, lambda command, _: self.verdicts.append(command.id), self.witness.watcher
        )

    @property
    def ids(self) -> list[str]:
        return [command.id for _, command in self.cell.operator.requests]

    @property
    def datagrams(self) -> list[tuple[int, bytes]]:
        assert self.cell.daemon is not None
        return self.cell.daemon.received


@pytest.fixture
async def people() -> People:
    return People()


async def test_a_command_is_one_of_its_operator(people: People) -> None:
    people.cell.operator.answers = [decided()]
    people.operators.clock.ahead = 60.0
    await people.operators.operate("anna", "placement.approach", {"fast": True})
    ((key, command),) = people.cell.operator.requests
    assert key == "cmd/anna/placement/approach"
    assert (command.source, command.branch, command.operation) == ("bus:anna", "placement", "approach")
    assert command.arguments == {"fast": True}
    assert command.sent == pytest.approx(people.operators.clock.wall(), abs=30.0), "by the clock of their machine"
    assert people.verdicts == [command.id]


async def test_an_outcome_that_nobody_tells_is_unknown(people: People) -> None:
    await people.operators.operate("anna", "placement.approach", {})
    assert people.verdicts == []


async def test_a_repeat_has_the_id_of_the_last_command(people: People) -> None:
    await people.operators.operate("anna", "placement.approach", {})
    await people.operators.operate("ben", "placement.home", {})
    await people.operators.repeat("anna")
    assert people.ids == ["anna-1", "ben-2", "anna-1"]
    await people.operators.repeat("carl")
    assert len(people.ids) == 3, "who has sent nothing repeats nothing"


async def test_another_operation_reuses_the_id_of_the_last_command(people: People) -> None:
    await people.operators.operate("anna", "placement.approach", {})
    await people.operators.reuse("anna", "toolplan.clear", {})
    assert people.ids == ["anna-1", "anna-1"]
    assert people.cell.operator.requests[1][1].operation == "clear"
    await people.operators.operate("anna", "placement.home", {})
    assert people.ids[-1] == "anna-2"


async def test_an_id_is_reused_whatever_is_sent_in_between(people: People, monkeypatch: pytest.MonkeyPatch) -> None:
    await people.operators.operate("anna", "placement.approach", {})
    await people.operators.operate("ben", "placement.home", {})
    monkeypatch.setattr(people.operators, "_send_until_answered", _sent)
    await people.operators.wire("anna", "close_the_socket", ())
    await people.operators.reuse("anna", "toolplan.clear", {})
    await people.operators.reuse("ben", "toolplan.clear", {})
    assert people.ids == ["anna-1", "ben-2", "anna-1", "ben-2"]


async def _sent(*_: Any) -> None:
    pass


async def test_who_has_sent_nothing_reuses_nothing(people: People) -> None:
    await people.operators.operate("ben", "placement.home", {})
    await people.operators.reuse("anna", "toolplan.clear", {})
    await people.operators.operate("anna", "placement.home", {})
    assert len(set(people.ids)) == 3


def test_a_datagram_is_sent_again_until_it_is_answered() -> None:
    async def send() -> tuple[list[tuple[int, bytes]], list[float]]:
        people, times = People(), list[float]()
        assert people.cell.daemon is not None

        def answers(data: bytes) -> list[str]:
            times.append(asyncio.get_running_loop().time())
            number = data.rpartition(b"#")[2].rstrip(b";").decode()
            return [] if len(times) < 3 else ["nonsense", "999_accepted_robot_1;", f"{number}_accepted_robot_1;"]

        people.cell.daemon.answers = answers
        await people.operators.wire("anna", "rob_conn_onxxxxx", ())
        return people.datagrams, times

    sent, times = run_on_simulated_loop(send())
    assert len(set(sent)) == 1, "with the same id"
    assert sent[0][0] == PORTS["anna"]
    assert times == [0.0, REPEAT_AFTER, 3 * REPEAT_AFTER]


def test_nobody_waits_for_ever() -> None:
    async def send() -> float:
        people = People()
        await people.operators.wire("anna", "rob_conn_onxxxxx", ())
        return asyncio.get_running_loop().time()

    assert PATIENCE <= run_on_simulated_loop(send()) < 2.5 * PATIENCE


async def test_what_the_library_of_a_client_refuses_is_not_sent(people: People) -> None:
    await people.operators.wire("anna", "no_such_command_", ())
    people.operators.old_client("no_such_command_", ())
    assert people.datagrams == []


async def test_any_datagram_is_sent_from_the_port_of_its_operator(people: People) -> None:
    people.operators.datagram("ben", b"\xff")
    people.cell.daemon, daemon = None, people.cell.daemon
    people.operators.datagram("ben", b"lost")
    people.operators.old_client("rob_conn_onxxxxx", ())
    people.cell.daemon = daemon
    assert people.datagrams == [(PORTS["ben"], b"\xff")]


async def test_a_string_command_with_an_id_is_seen_when_it_arrives(
    people: People, monkeypatch: pytest.MonkeyPatch
) -> None:
    arrived: list[str] = []
    monkeypatch.setattr(people.witness.watcher, "command_arrived", lambda key, _now: arrived.append(key))
    assert people.cell.daemon is not None
    people.cell.daemon.answers = lambda data: [f"{data.rpartition(b'#')[2].rstrip(b';').decode()}_accepted_robot_1;"]
    await people.operators.wire("anna", "rob_conn_onxxxxx", ())
    people.operators.datagram("ben", b"no command")
    assert arrived == ["1"]


def test_an_old_client_gets_its_second_datagram_soon(monkeypatch: pytest.MonkeyPatch) -> None:
    async def send(late: float) -> Any:
        people = People()
        daemon = people.cell.daemon
        assert daemon is not None
        loop = asyncio.get_running_loop()

        def receive(port: int, data: bytes, _answer: Any, acknowledge: Any) -> None:
            daemon.received.append((port, data))
            acknowledge("ok")
            loop.call_later(late, acknowledge, "ok")

        monkeypatch.setattr(daemon, "receive", receive)
        people.operators.old_client("rob_conn_onxxxxx", ())
        await asyncio.sleep(5.0)
        assert people.datagrams[0][0] == OLD_PORT
        assert b"#" not in people.datagrams[0][1], "it knows no ids"
        return people.witness.violation

    assert run_on_simulated_loop(send(0.1)) is None
    assert run_on_simulated_loop(send(2.0)).invariant == "no_second_is_late"


async def test_operators_see_the_last_snapshot(people: People) -> None:
    assert people.operators.snapshot is None
    people.cell.operator.handlers["state/fsm"]("state/fsm", shown(4))
    assert people.operators.snapshot == shown(4)
    people.operators.stop("ben")
    assert people.cell.operator.published == ["stop/ben"]
