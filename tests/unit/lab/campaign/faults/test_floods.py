"""Rows of floods of the bus: presses and rejections are all counted, and Stop is no later than a bare timer."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from pcmrs.dispatcher.decisions import DROPPED
from pcmrs.dispatcher.events import PRESSED_AGAIN
from pcmrs.errors import BusError
from pcmrs.messages.clipping import CLIPPED
from pcmrs.testing.errors import Unmet
from pcmrs_lab.campaign.bus_flood import FLOODER, FloodReport
from pcmrs_lab.campaign.faults import floods
from pcmrs_lab.campaign.faults.floods import STOPS
from pcmrs_lab.campaign.sham import sham
from tests.unit.lab.campaign.faults.operated import OperatedCell, run
from tests.unit.lab.scripted_client import row, verdict

EVE = f"bus:{FLOODER}"


def pressed(*again: int) -> list[Any]:
    rows = [row("device", operation="stopped", source=EVE)]
    rows += [
        row("device", operation=PRESSED_AGAIN, source=EVE, result={"fields": {"presses": number}}) for number in again
    ]
    return [*rows, row("device", operation="stopped", source="bus:anna")]


async def test_presses_are_counted_with_those_that_were_joined() -> None:
    cell = OperatedCell()
    cell.client.rows += pressed(400, 599)
    assert await floods._presses(cell.as_cell, 0) == {"presses": 1000, "rows": 3}
    assert await floods._presses(cell.as_cell, 4) == {"presses": 0, "rows": 0}


def test_a_flood_is_over_when_no_more_presses_come(monkeypatch: pytest.MonkeyPatch) -> None:
    cell = OperatedCell()
    counts = [1, 5, 9, 9, 10]

    async def presses(*_: Any) -> dict[str, int]:
        return {"presses": counts.pop(0)}

    monkeypatch.setattr(floods, "_presses", presses)
    run(monkeypatch, floods._until_over(cell.as_cell, 0))
    assert counts == [10]


def refused(count: int, dropped: int, *, clipped: bool = True) -> list[Any]:
    decided = verdict("toolplan.plan", "rejected", "malformed")
    arguments = {CLIPPED: 60_000} if clipped else {}
    rows = [row(verdict=decided, source=EVE, arguments=arguments) for _ in range(count)]
    return [*rows, row("device", operation=DROPPED, result={"fields": {"user": FLOODER, "count": dropped}})]


def test_every_rejection_has_a_row_or_is_counted(monkeypatch: pytest.MonkeyPatch) -> None:
    cell = OperatedCell()
    cell.client.rows += [row("device", operation=DROPPED, result={"fields": {"user": "anna", "count": 7}})]
    cell.client.rows += refused(20, 80)
    assert run(monkeypatch, floods._on_record(cell.as_cell, 0, FLOODER, 100)) == (20, 80)


def test_rejections_without_a_trace_are_unmet(monkeypatch: pytest.MonkeyPatch) -> None:
    cell = OperatedCell()
    cell.client.rows += refused(20, 79)
    now = [0.0]

    def monotonic() -> float:
        now[0] += 10.0
        return now[0]

    monkeypatch.setattr("time.monotonic", monotonic)
    with pytest.raises(Unmet, match="100 were rejected: 20 rows, and 79 are counted"):
        run(monkeypatch, floods._on_record(cell.as_cell, 0, FLOODER, 100))


def test_arguments_without_a_limit_are_unmet(monkeypatch: pytest.MonkeyPatch) -> None:
    cell = OperatedCell()
    cell.client.rows += refused(20, 80, clipped=False)
    with pytest.raises(Unmet, match="No argument was clipped"):
        run(monkeypatch, floods._on_record(cell.as_cell, 0, FLOODER, 100))


class Flooded(OperatedCell):
    """A cell during a flood, and a timer beside it.

    Attributes:
        took: Time that each Stop takes, s.
        late: Lateness of the timer, s.
    """

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        super().__init__()
        self.took, self.late = 0.01, 0.005
        self.report = FloodReport(sent=5000, seconds=2.0, answered=4000, codes={"accepted": 4000})
        self.error: Exception | None = None
        monkeypatch.setattr(floods, "bus_flood", self._flood)
        monkeypatch.setattr(floods, "timer_lateness", self._timer)
        monkeypatch.setattr(floods, "stop_times", self._stops)

    @asynccontextmanager
    async def _flood(self, *_: Any, **__: Any) -> AsyncIterator[Any]:
        yield SimpleNamespace(report=self.report)

    @asynccontextmanager
    async def _timer(self) -> AsyncIterator[Any]:
        yield SimpleNamespace(late=[self.late] * 100)

    async def _stops(self, _: Any, times: int) -> list[float]:
        if self.error:
            raise self.error
        return [self.took] * times


@pytest.fixture
def flooded(monkeypatch: pytest.MonkeyPatch) -> Flooded:
    return Flooded(monkeypatch)


async def test_stops_are_compared_with_a_bare_timer(flooded: Flooded) -> None:
    found = await floods._stops_in_time(flooded.as_cell, "setup")
    assert found["setup_hz"] == 2500
    assert found["setup_answers"] == {"accepted": 4000}
    assert (found["stop_setup_p99_ms"], found["timer_setup_p99_ms"]) == (10.0, 5.0)
    flooded.took, flooded.late = 5.0, 4.96
    await floods._stops_in_time(flooded.as_cell, "setup")
    flooded.late = 4.92
    with pytest.raises(Unmet, match=r"Stop during setup was late: p99 5000\.0 ms, limit 50 ms and"):
        await floods._stops_in_time(flooded.as_cell, "setup")


async def test_a_flood_of_nothing_proves_nothing(flooded: Flooded) -> None:
    flooded.report = FloodReport(sent=STOPS)
    with pytest.raises(Unmet, match=f"Of setup only {STOPS} were sent"):
        await floods._stops_in_time(flooded.as_cell, "setup")


async def test_another_user_who_is_not_answered_is_unmet(flooded: Flooded) -> None:
    flooded.error = BusError("Nobody answers.")
    with pytest.raises(Unmet, match="During setup another user was not answered: Nobody answers"):
        await floods._stops_in_time(flooded.as_cell, "setup")


async def test_refused_requests_are_those_of_the_bus(monkeypatch: pytest.MonkeyPatch) -> None:
    cell = OperatedCell()
    queues = [("bus", 3), ("bus", None), ("gateway", 9)]

    async def health() -> Any:
        return SimpleNamespace(queues=[SimpleNamespace(queue=name, refused=count) for name, count in queues])

    monkeypatch.setattr(cell.client, "health", health)
    assert await floods._refused_requests(cell.as_cell) == 3


def test_the_size_of_a_journal_is_that_of_all_its_files(tmp_path: Path) -> None:
    cell = OperatedCell(tmp_path)
    for name, size in (("ratms.sqlite", 10), ("ratms.sqlite.0002", 20), ("ratms.sqlite.0002-wal", 5), ("other", 99)):
        (tmp_path / name).write_bytes(bytes(size))
    assert floods._size(cell.as_cell) == 35


@pytest.mark.parametrize("is_sham", [False, True])
def test_rejected_commands_are_sent_until_the_end(monkeypatch: pytest.MonkeyPatch, is_sham: bool) -> None:
    cell = OperatedCell()
    cell.client.refuses["stimulation.set_intensity"] = "out_of_range"

    async def send() -> int:
        requesting = asyncio.create_task(floods._request_rejected(cell.as_cell))
        await asyncio.sleep(2.2)
        requesting.cancel()
        return await requesting

    if is_sham:
        with sham():
            assert run(monkeypatch, send()) == 0
    else:
        assert run(monkeypatch, send()) == 5


@pytest.mark.parametrize("is_sham", [False, True])
def test_accepted_commands_of_a_planner_are_sent_until_the_end(monkeypatch: pytest.MonkeyPatch, is_sham: bool) -> None:
    cell = OperatedCell()

    async def send() -> int:
        requesting = asyncio.create_task(floods._request_accepted(cell.as_cell.planner))
        await asyncio.sleep(2.2)
        requesting.cancel()
        return await requesting

    if is_sham:
        with sham():
            assert run(monkeypatch, send()) == 0
        assert cell.planner.asked == []
    else:
        assert run(monkeypatch, send()) == 5


async def test_messages_without_a_seal_are_counted_by_the_daemon(monkeypatch: pytest.MonkeyPatch) -> None:
    cell = OperatedCell()

    async def health() -> Any:
        return SimpleNamespace(dropped={"bus.not_sealed": 7, "bus.ignored": 9})

    monkeypatch.setattr(cell.client, "health", health)
    assert await floods._unsealed(cell.as_cell) == 7
