"""Rows of datagrams: each command is done exactly once, and what has overtaken or come late is by the journal."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from pcmrs.errors import UnknownOutcomeError
from pcmrs.planner import PlannerVerdict
from pcmrs.testing.errors import Unmet
from pcmrs_lab.campaign.fault import Evidence, Injector
from pcmrs_lab.campaign.faults import network_datagrams
from pcmrs_lab.campaign.faults.network_datagrams import COMMANDS_SENT, IMPATIENT
from pcmrs_lab.campaign.network_impairment import InjectedImpairment
from tests.unit.lab.campaign.faults.operated import OperatedCell, lab_of, proves, run
from tests.unit.lab.scripted_client import row, verdict

ACCEPTED = PlannerVerdict("accepted", "toolplan", "0", None, ())


def outcome(number: int | str, branch: str = "toolplan", **more: Any) -> Any:
    return row(verdict=verdict(f"{branch}.reinit", id=str(number)), source="udp:planner", **more)


def checked(*numbers: int) -> int:
    cell = OperatedCell()
    cell.client.rows += [outcome(number) for number in numbers] + [outcome("x", "registration"), row("intent")]
    return network_datagrams._check_once(cell.as_cell, 0, 3, "toolplan")


def test_each_command_has_one_outcome() -> None:
    assert checked(1, 2, 3) == 3
    for numbers, text in (((1, 2), "2 outcomes of 2"), ((1, 2, 3, 3), "4 outcomes of 3"), ((1, 2, 3, 4), "of 4")):
        with pytest.raises(Unmet, match=text):
            checked(*numbers)


class Sent(OperatedCell):
    """A cell whose planner's commands are done as a test says.

    Attributes:
        done: Times that each command is done.
        takes: Time for which each command waits for its answer, s.
    """

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        super().__init__()
        self.done: Callable[[int], int] = lambda _: 1
        self.takes: Callable[[int], float] = lambda _: 0.0
        self.datagrams = 100
        self.commands = 0
        self.impairments: list[InjectedImpairment] = []
        self.counts = {"lost": 3, "doubled": 5, "overtaken": 1}
        monkeypatch.setattr(network_datagrams, "_proxied", self._proxied)
        monkeypatch.setattr(self.client, "health", self._health)
        monkeypatch.setattr(self.planner, "command", self.command)

    @asynccontextmanager
    async def _proxied(self, _: Any, impairment: InjectedImpairment) -> AsyncIterator[Any]:
        self.impairments.append(impairment)
        if len(self.impairments) == 1:
            impairment.counted.update(self.counts)
        yield self.planner

    async def _health(self) -> Any:
        return SimpleNamespace(datagrams=self.datagrams)

    async def command(self, name: str, *values: Any, timeout: float = 10.0) -> PlannerVerdict:
        self.commands += 1
        number = self.commands
        self.datagrams += 1
        for _ in range(self.done(number)):
            self.client.rows.append(outcome(number, wall=1.8e9))
        await asyncio.sleep(self.takes(number))
        return ACCEPTED


@pytest.fixture
def sent(monkeypatch: pytest.MonkeyPatch) -> Sent:
    return Sent(monkeypatch)


def ran(monkeypatch: pytest.MonkeyPatch, folder: Path, cell: Sent, injection: Injector) -> Evidence:
    return run(monkeypatch, injection(lab_of(folder, cell)))


def test_lost_datagrams_are_sent_again_and_done_once(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, sent: Sent
) -> None:
    sent.takes = lambda number: 5.0 if number in (2, 7) else 0.0
    found = ran(monkeypatch, tmp_path, sent, network_datagrams.datagrams_are_lost)
    assert proves(found)
    assert found.took_place == {"commands_sent_again": 2}
    assert found.control == {"done_in_good_weather": COMMANDS_SENT, "arrived_in_good_weather": COMMANDS_SENT}
    first, second = sent.impairments
    assert (first.loss, second.loss) == (0.2, 0.0)


def test_a_command_that_is_done_twice_or_never_is_unmet(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, sent: Sent
) -> None:
    sent.done = lambda number: 2 if number == 3 else 1
    with pytest.raises(Unmet, match=f"{COMMANDS_SENT + 1} outcomes of {COMMANDS_SENT} commands"):
        ran(monkeypatch, tmp_path, sent, network_datagrams.datagrams_are_doubled)
    sent.done = lambda number: 0 if number % 5 == 0 else 1
    with pytest.raises(Unmet, match="commands were sent"):
        ran(monkeypatch, tmp_path, sent, network_datagrams.datagrams_are_lost)


def test_a_link_that_lost_nothing_proves_nothing(monkeypatch: pytest.MonkeyPatch, tmp_path: Path, sent: Sent) -> None:
    sent.counts["lost"] = 0
    with pytest.raises(Unmet, match="Nothing was lost: choose another seed"):
        ran(monkeypatch, tmp_path, sent, network_datagrams.datagrams_are_lost)


def test_doubled_datagrams_are_those_beyond_the_sent_ones(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, sent: Sent
) -> None:

    def take(number: int) -> float:
        sent.datagrams += number <= 4
        return 0.0

    sent.takes = take
    found = ran(monkeypatch, tmp_path, sent, network_datagrams.datagrams_are_doubled)
    assert found.took_place == {"more_than_were_sent": 4}


def test_commands_that_others_overtook_are_counted(monkeypatch: pytest.MonkeyPatch, sent: Sent) -> None:
    order = [0, 2, 1, 3, 6, 5, 4, 7, 8, 9, 10, 11]

    async def command(name: str, index: int) -> PlannerVerdict:
        decided = verdict("digitization.digitize_one", "rejected", "no_plan", id=str(index))
        sent.client.rows.append(row(verdict=decided, arguments={"index": order[index]}))
        return ACCEPTED

    monkeypatch.setattr(sent.planner, "command", command)
    assert run(monkeypatch, network_datagrams._out_of_order(sent.as_cell, sent.planner)) == 3  # type: ignore[arg-type]


def test_an_impatient_sender_is_told_that_time_is_over(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, sent: Sent
) -> None:
    late = [1.0]

    async def command(name: str, *values: Any, timeout: float = 10.0) -> PlannerVerdict:
        sent.commands += 1
        if sent.commands > 1:
            sent.client.rows.append(outcome(sent.commands, wall=1.8e9 + late[0]))
            if timeout == IMPATIENT:
                raise UnknownOutcomeError("It was late.")
        return ACCEPTED

    monkeypatch.setattr("time.time", lambda: 1.8e9)
    monkeypatch.setattr(sent.planner, "command", command)
    found = ran(monkeypatch, tmp_path, sent, network_datagrams.answers_take_half_a_second)
    assert proves(found)
    assert found.took_place == {"first_done_after_s": 1.0}
    assert found.details["timeouts"] == 3
    sent.commands, late[0] = 0, 0.1
    with pytest.raises(Unmet, match=r"done 0\.100 s after it was sent"):
        ran(monkeypatch, tmp_path, sent, network_datagrams.answers_take_half_a_second)
    monkeypatch.setattr(sent.planner, "command", sent.command)
    with pytest.raises(Unmet, match="0 of 3 impatient commands"):
        ran(monkeypatch, tmp_path, sent, network_datagrams.answers_take_half_a_second)


@pytest.mark.parametrize(
    ("answers", "text"),
    [(["9_rejected_x_0_no_rotation;"], ""), (["9_rejected_x_0_busy;"], "expected one of"), ([], "There was no answer")],
)
async def test_a_refusal_has_one_of_its_reasons(monkeypatch: pytest.MonkeyPatch, answers: list[str], text: str) -> None:
    async def refused_all(*_: Any, **__: Any) -> dict[str, Any]:
        return {"refused": 1, "answers": answers}

    monkeypatch.setattr(network_datagrams, "refused_all", refused_all)
    work = network_datagrams.refused_all_with_reasons(OperatedCell().as_cell, [b"x"], {"no_rotation"})
    if not text:
        assert (await work)["answers"] == answers
        return
    with pytest.raises(Unmet, match=text):
        await work
