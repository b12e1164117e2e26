"""A soak test tells what grows from what only wavers, and reports a cell that ended or was not operated."""

from __future__ import annotations

import asyncio
import random
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec.structs import replace

from pcmrs.clock import Clock
from pcmrs.errors import UnknownOutcomeError
from pcmrs.messages import Verdict
from pcmrs.simulated_time.clock import SimulatedClock
from pcmrs.testing.loop import run_on_simulated_loop
from pcmrs_lab.campaign import soaking
from pcmrs_lab.campaign.samples import ResourceSample
from pcmrs_lab.campaign.soaking import ALLOWED, SoakReport, soak, trend
from tests.support.trials import examples
from tests.unit.lab.campaign.scripted_cell import ScriptedCell
from tests.unit.lab.scripted_client import verdict

WELL = SoakReport(1.0, 1, 100, 0, {"accepted": 100}, 1, "", [])


@pytest.mark.parametrize("measure", ALLOWED)
@examples(25)
@given(seed=st.integers(0, 100))
def test_wavering_course_is_flat_and_growing_one_is_not(measure: str, seed: int) -> None:
    generator = random.Random(seed)
    allowed = ALLOWED[measure]
    times = [float(number) for number in range(200)]
    wavering = [10 * allowed + generator.gauss(0.0, allowed / 4) for _ in times]
    growing = [value + 3 * allowed * time / times[-1] for time, value in zip(times, wavering, strict=True)]
    assert trend("daemon", measure, times, wavering).flat
    assert not trend("daemon", measure, times, growing).flat


def test_course_that_grows_only_during_warm_up_is_flat() -> None:
    times = [float(number) for number in range(100)]
    values = [1e8 + min(time, 15.0) * 4e6 for time in times]
    assert trend("daemon", "memory", times, values).flat


def test_a_course_without_samples_is_flat() -> None:
    assert trend("daemon", "memory", [], []).flat


def test_soak_in_which_hardly_anything_is_accepted_fails() -> None:
    report = replace(WELL, decisions={"accepted": 49, "rejected": 51})
    assert report.violated
    assert not replace(report, decisions={"accepted": 50, "rejected": 50}).violated


def test_a_soak_without_any_command_shows_nothing() -> None:
    assert replace(WELL, steps=0, decisions={}).violated


def test_a_soak_that_ended_early_or_grew_fails() -> None:
    assert not WELL.violated
    assert replace(WELL, ended="The daemon is gone.").violated
    times = [float(number) for number in range(100)]
    grown = trend("node", "threads", times, times)
    assert replace(WELL, courses=[grown]).violated


class ScriptedOperator:
    """An operator of one command a second; every tenth is Stop.

    Attributes:
        ends: Error of the command with that number.
    """

    ends: tuple[int, Exception] | None = None

    def __init__(self, _client: Any, _generator: Any) -> None:
        self.verdicts: dict[str, Verdict] = {}
        self.stops = self._steps = 0

    async def step(self) -> Verdict | None:
        await asyncio.sleep(1.0)
        self._steps += 1
        if self.ends is not None and self._steps == self.ends[0]:
            raise self.ends[1]
        if self._steps % 10 == 0:
            self.stops += 1
            return None
        self.verdicts[str(self._steps)] = verdict()
        return verdict(decision="rejected" if self._steps % 10 == 1 else "accepted", code="busy")


class Soaked:
    """A cell that is soaked; its processes end, or its saboteur falls silent, after so many samples."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.cell = ScriptedCell()
        self.samples = 0
        self.ends_after: int | None = None
        self.orders: list[str] = []
        self.prefix: tuple[str, ...] = ()
        monkeypatch.setattr(soaking, "open_cell", self._open)
        monkeypatch.setattr(soaking, "RandomOperator", ScriptedOperator)
        monkeypatch.setattr(soaking, "processes_of", lambda pid: [("daemon", pid), ("node", pid + 1)])
        monkeypatch.setattr(soaking, "sample", self._sample)
        monkeypatch.setattr(soaking, "order", self._order)
        monkeypatch.setattr(ScriptedOperator, "ends", None)

    @asynccontextmanager
    async def _open(self, _: Path, settings: tuple[str, ...], *, prefix: tuple[str, ...]) -> AsyncIterator[Any]:
        self.prefix = prefix
        yield self.cell

    def _sample(self, pid: int) -> ResourceSample:
        self.samples += 1
        if self.ends_after is not None and self.samples > self.ends_after:
            raise FileNotFoundError(2, "No such file or directory", f"/proc/{pid}/statm")
        return ResourceSample(memory=1 << 20, descriptors=pid, threads=4)

    async def _order(self, _: Path, text: str) -> str:
        self.orders.append(text)
        return "7"


def soaked(hours: float, progress: Any = lambda *_: None) -> SoakReport:
    async def run() -> SoakReport:
        clock: Clock = SimulatedClock(asyncio.get_running_loop())
        return await soak(hours, 3, Path("folder"), clock, progress=progress)

    return run_on_simulated_loop(run())


def test_every_process_is_sampled_while_the_cell_is_operated(monkeypatch: pytest.MonkeyPatch) -> None:
    cell = Soaked(monkeypatch)
    seen: list[tuple[str, int, int]] = []
    report = soaked(100.5 / 3600.0, lambda *shown: seen.append(shown))
    assert {(each.process, each.measure) for each in report.courses} == {
        *(("daemon", measure) for measure in ALLOWED),
        *(("node", measure) for measure in ALLOWED if measure != "tasks"),
    }
    assert all(len(each.times) == 101 for each in report.courses), "one sample a second"
    assert (report.steps, report.stops, report.decisions) == (100, 10, {"rejected": 10, "accepted": 80})
    assert (report.ended, report.violated, report.seed) == ("", False, 3)
    assert report.seconds == pytest.approx(100.5)
    assert seen[-1] == ("seconds", 100, 100)
    assert "orders" in cell.prefix[-1]


def test_a_long_soak_takes_no_more_samples(monkeypatch: pytest.MonkeyPatch) -> None:
    Soaked(monkeypatch)
    monkeypatch.setattr(ScriptedOperator, "step", _wait)
    monkeypatch.setattr(soaking, "SAMPLES", 20)
    report = soaked(10.0)
    assert all(len(each.times) == 20 for each in report.courses)


async def _wait(_: Any) -> None:
    await asyncio.sleep(1e4)


def test_a_soak_ends_with_its_operator_and_says_why(monkeypatch: pytest.MonkeyPatch) -> None:
    Soaked(monkeypatch)
    monkeypatch.setattr(ScriptedOperator, "ends", (5, UnknownOutcomeError("The daemon is gone.")))
    report = soaked(1.0)
    assert (report.ended, report.steps, report.rows) == ("The daemon is gone.", 4, 0)
    assert report.seconds == pytest.approx(5.0)
    monkeypatch.setattr(ScriptedOperator, "ends", (5, KeyError("branch")))
    assert soaked(1.0).ended == "KeyError('branch')"


def test_a_soak_of_which_a_process_ends_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    Soaked(monkeypatch).ends_after = 9
    report = soaked(1.0)
    assert "/proc/4712/statm" in report.ended
    assert report.violated
    assert {len(each.times) for each in report.courses} == {4, 5}


def test_a_saboteur_that_is_gone_ends_a_soak(monkeypatch: pytest.MonkeyPatch) -> None:
    Soaked(monkeypatch)

    async def refuse(*_: Any) -> str:
        raise ConnectionRefusedError(111, "Connection refused")

    monkeypatch.setattr(soaking, "order", refuse)
    assert "Connection refused" in soaked(1.0).ended
