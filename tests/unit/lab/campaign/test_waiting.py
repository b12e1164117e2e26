"""Waiting by polling ends with how long it took, or with what is missing."""

from __future__ import annotations

import asyncio

import pytest

from pcmrs.testing.errors import Unmet
from pcmrs_lab.campaign.waiting import PERIOD, until_ended, until_logged, until_true
from tests.unit.lab.campaign.scripted_cell import ScriptedCell, run


def test_a_condition_that_comes_true_tells_how_long_it_took(monkeypatch: pytest.MonkeyPatch) -> None:
    async def wait() -> float:
        seen: list[int] = []
        asyncio.get_running_loop().call_later(0.5, seen.append, 1)
        return await until_true(lambda: bool(seen), "Nothing was seen")

    assert run(monkeypatch, wait()) == pytest.approx(0.5, abs=2 * PERIOD)


def test_a_condition_that_holds_already_takes_no_time(monkeypatch: pytest.MonkeyPatch) -> None:
    assert run(monkeypatch, until_true(lambda: True, "")) == 0.0


def test_what_does_not_come_is_named_with_the_limit(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(Unmet, match=r"The node sends no heartbeat within 1\.5 s\."):
        run(monkeypatch, until_true(lambda: False, "The node sends no heartbeat", 1.5))


def test_the_end_of_a_daemon_is_its_exit_status(monkeypatch: pytest.MonkeyPatch) -> None:
    async def wait() -> int:
        cell = ScriptedCell()
        asyncio.get_running_loop().call_later(2.0, cell.process.terminate)
        return await until_ended(cell.as_cell)

    assert run(monkeypatch, wait()) == -15
    with pytest.raises(Unmet, match="has not ended within 20 s"):
        run(monkeypatch, until_ended(ScriptedCell().as_cell))


def test_words_are_waited_for_in_the_log(monkeypatch: pytest.MonkeyPatch) -> None:
    async def wait() -> float:
        cell = ScriptedCell()
        asyncio.get_running_loop().call_later(1.0, setattr, cell, "log", "2026 held_by_node robot\n")
        return await until_logged(cell.as_cell, "held_by_node")

    assert run(monkeypatch, wait()) == pytest.approx(1.0, abs=2 * PERIOD)
    with pytest.raises(Unmet, match="The log does not contain 'stall'"):
        run(monkeypatch, until_logged(ScriptedCell().as_cell, "stall"))
