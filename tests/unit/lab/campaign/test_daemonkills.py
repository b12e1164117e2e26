"""Killed daemons: where they died, what they had answered, and which of it their journal has."""

from __future__ import annotations

import asyncio
import signal
from collections.abc import AsyncIterator, Callable, Mapping
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import pytest

from pcmrs.clock import SystemClock
from pcmrs.errors import BusError, DeviceError, JournalError, UnknownOutcomeError
from pcmrs.failpoints import FAILPOINTS, VARIABLE
from pcmrs.journal import Journal
from pcmrs.messages import Verdict
from pcmrs.testing.clock import ManualClock
from pcmrs_lab.campaign import daemonkills
from pcmrs_lab.campaign.daemonkills import AT_START, DIES_WITHIN, LATEST, kill_daemons
from pcmrs_lab.campaign.kills import RANDOM, KillReport
from pcmrs_lab.campaign.sham import sham
from tests.unit.lab.campaign.scripted_cell import ScriptedCell, run
from tests.unit.lab.scripted_client import row, verdict

EACH = len(FAILPOINTS) + 1
"""Number of daemons of which one dies at every failpoint, and one at a random instant."""


class ScriptedDaemons:
    """Daemons that die as a test says.

    Attributes:
        dies: Called with an armed failpoint, and returns the exit status with which the daemon ends by itself, if any.
        lost: Number of verdicts that are missing after each.
        armed: Failpoints, in order.
        lived: Time for which each was operated, s.
        refuses: Error of the next start.
    """

    def __init__(self) -> None:
        self.dies: Callable[[str], int | None] = lambda _: -signal.SIGKILL
        self.lost: list[int] = []
        self.armed: list[str] = []
        self.lived: list[float] = []
        self.refuses: Exception | None = None
        self.at_end: Exception | None = None

    @asynccontextmanager
    async def open_cell(
        self, folder: Path, settings: tuple[str, ...], *, environment: Mapping[str, str]
    ) -> AsyncIterator[ScriptedCell]:
        if self.refuses:
            raise self.refuses
        self.armed.append(environment.get(VARIABLE, ""))
        cell = ScriptedCell(folder)
        status = self.dies(self.armed[-1])
        loop = asyncio.get_running_loop()
        began = loop.time()
        if self.armed[-1] and status is not None:
            loop.call_later(2.0, lambda: setattr(cell.process, "returncode", status))
        yield cell
        self.lived.append(loop.time() - began)
        if self.at_end:
            raise self.at_end


class ScriptedOperator:
    """An operator with one verdict a second, until the daemon is gone."""

    number = 0

    def __init__(self, _client: Any, _generator: Any) -> None:
        self.verdicts: dict[str, Verdict] = {}

    async def step(self) -> None:
        await asyncio.sleep(1.0)
        ScriptedOperator.number += 1
        self.verdicts[f"c{ScriptedOperator.number}"] = verdict()
        if len(self.verdicts) > 1:
            raise UnknownOutcomeError("The daemon is gone.")


@pytest.fixture
def daemons(monkeypatch: pytest.MonkeyPatch) -> ScriptedDaemons:
    made = ScriptedDaemons()
    monkeypatch.setattr(daemonkills, "open_cell", made.open_cell)
    monkeypatch.setattr(daemonkills, "RandomOperator", ScriptedOperator)
    monkeypatch.setattr(daemonkills, "_lost", lambda *_: made.lost.pop(0) if made.lost else 0)
    monkeypatch.setattr(daemonkills, "log_tail", lambda _: "the end of its log")
    return made


def killed(monkeypatch: pytest.MonkeyPatch, times: int, **more: Any) -> KillReport:
    return run(monkeypatch, kill_daemons(times, 1, more.pop("clock", SystemClock()), **more))


def test_a_daemon_dies_at_each_failpoint_and_at_random(
    daemons: ScriptedDaemons, monkeypatch: pytest.MonkeyPatch
) -> None:
    report = killed(monkeypatch, EACH)
    assert report.at == {**dict.fromkeys(FAILPOINTS, 1), RANDOM: 1}
    assert (report.kills, report.not_reached, report.lost) == (EACH, {}, 0)
    assert report.acknowledged >= EACH - 1
    assert not report.violated
    for name, armed in zip(FAILPOINTS, daemons.armed, strict=False):
        place, _, number = armed.partition(":")
        first = AT_START if name.startswith("journal.") else 1
        assert place == name
        assert first <= int(number) < first + LATEST


def test_a_failpoint_that_is_not_reached_is_counted_so(
    daemons: ScriptedDaemons, monkeypatch: pytest.MonkeyPatch
) -> None:
    daemons.dies = lambda _: None
    report = killed(monkeypatch, 2)
    assert report.not_reached == dict.fromkeys(FAILPOINTS[:2], 1)
    assert report.at == {}
    assert daemons.lived == pytest.approx([DIES_WITHIN] * 2, abs=0.2)


def test_a_daemon_that_ends_by_itself_was_not_killed(daemons: ScriptedDaemons, monkeypatch: pytest.MonkeyPatch) -> None:
    daemons.dies = lambda _: 70
    report = killed(monkeypatch, 5)
    assert report.kills == 0
    assert report.refused == ["A daemon in operation ended by itself, with exit status 70: the end of its log"]
    assert report.violated


@pytest.mark.parametrize("error", [DeviceError("It did not start."), BusError("It did not start.")])
def test_a_daemon_that_does_not_start_ends_the_run(
    daemons: ScriptedDaemons, monkeypatch: pytest.MonkeyPatch, error: Exception
) -> None:
    daemons.refuses = error
    report = killed(monkeypatch, 5)
    assert (report.kills, report.refused, report.violated) == (0, ["It did not start."], True)


def test_a_client_may_lose_its_daemon_at_the_end(daemons: ScriptedDaemons, monkeypatch: pytest.MonkeyPatch) -> None:
    daemons.at_end = UnknownOutcomeError("The daemon is gone.")
    report = killed(monkeypatch, 1)
    assert (report.kills, report.refused) == (1, [])


def test_lost_verdicts_violate(daemons: ScriptedDaemons, monkeypatch: pytest.MonkeyPatch) -> None:
    daemons.lost = [0, 2]
    report = killed(monkeypatch, 2)
    assert (report.lost, report.violated) == (2, True)


@pytest.mark.usefixtures("daemons")
def test_a_journal_that_cannot_be_read_ends_the_run(monkeypatch: pytest.MonkeyPatch) -> None:
    def lost(*_: Any) -> int:
        raise JournalError("The journal is damaged.")

    monkeypatch.setattr(daemonkills, "_lost", lost)
    assert killed(monkeypatch, 5).refused == ["The journal is damaged."]


@pytest.mark.usefixtures("daemons")
def test_a_run_ends_when_its_time_is_over(monkeypatch: pytest.MonkeyPatch) -> None:
    clock = ManualClock()
    report = killed(monkeypatch, 50, clock=clock, minutes=1.0, progress=lambda *_: clock.stall(25.0))
    assert (report.kills, report.seconds) == (3, 75.0)


def test_nothing_is_killed_in_a_sham_campaign(daemons: ScriptedDaemons, monkeypatch: pytest.MonkeyPatch) -> None:
    with sham():
        assert killed(monkeypatch, 5).kills == 0
    assert daemons.armed == []


async def test_a_verdict_must_be_in_the_journal_unchanged(tmp_path: Path) -> None:
    kept, changed, missing = verdict(id="1"), verdict(id="2"), verdict(id="3")
    journal = Journal.open(tmp_path / "ratms.sqlite")
    await journal.append([row(verdict=kept), row(verdict=verdict("robot.connect", id="2"))])
    await journal.close()
    assert daemonkills._lost(tmp_path / "ratms.sqlite", {"1": kept}) == 0
    assert daemonkills._lost(tmp_path / "ratms.sqlite", {"1": kept, "2": changed, "3": missing}) == 2
    with pytest.raises(JournalError):
        daemonkills._lost(tmp_path / "none.sqlite", {"1": kept})
