"""Fuzzed datagrams ask for nothing that could change a cell, and cover the grammar's refusals."""

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

from pcmrs.errors import PayloadError
from pcmrs.gateway.commands import COMMANDS
from pcmrs.gateway.grammar import parse, parse_tool_points
from pcmrs.simulated_time.clock import SimulatedClock
from pcmrs.testing.errors import Unmet
from pcmrs.testing.loop import run_on_simulated_loop
from pcmrs_lab.campaign import fuzz as fuzzing
from pcmrs_lab.campaign.fuzz import GROWTH_MB, HARMLESS, WINDOW, FuzzReport, datagram, dropped, fuzz
from pcmrs_lab.campaign.samples import ResourceSample
from tests.unit.lab.campaign.faults.operated import OperatedCell
from tests.unit.lab.campaign.faults.scripted_raw import ScriptedRaw
from tests.unit.lab.scripted_client import row


@given(seed=st.integers(0, 1 << 32))
def test_fuzzed_datagram_that_parses_is_harmless(seed: int) -> None:
    generator = random.Random(seed)
    for _ in range(50):
        sent = datagram(generator)
        try:
            assert parse_tool_points(sent) is None
            request = parse(sent)
        except PayloadError:
            continue
        assert request.spec.action in HARMLESS


def test_every_command_and_every_reason_for_refusing_comes_up() -> None:
    generator = random.Random(1)
    names, reasons = set(), set()
    for _ in range(6_000):
        sent = datagram(generator)
        names.add(sent[:16])
        try:
            parse(sent)
        except PayloadError as error:
            reasons.add(next((word for word in REASONS if word in error.text), error.text))
    assert reasons == set(REASONS)
    assert {name.encode() for name in COMMANDS} <= names


REASONS = (
    "is not a command",
    "no terminator",
    "follows the terminator",
    "not printable",
    "the limit is 256",
    "tokens, got",
    "tokens start with",
    "finite decimal",
    "takes an index",
)

CLEAN = FuzzReport(1000, 0, 5, 100.0, False, False, 0, 0.0, 1, 10.0)


@pytest.mark.parametrize(
    ("found", "violated"),
    [
        ({"dropped": 9}, False),
        ({"crashed": True}, True),
        ({"state_changed": True}, True),
        ({"rows": 1}, True),
        ({"growth_mb": GROWTH_MB}, True),
    ],
)
def test_a_daemon_that_ended_executed_or_grew_fails(found: dict[str, Any], violated: bool) -> None:
    assert replace(CLEAN, **found).violated is violated


def test_what_the_kernel_dropped_is_that_of_the_port(monkeypatch: pytest.MonkeyPatch) -> None:
    rows = ["sl local rem ... drops", "1: 0100007F:1F90 0 7", "2: 00000000:1F90 0 3", "3: 0100007F:1F91 0 50"]
    monkeypatch.setattr(Path, "read_text", lambda _: "\n".join(rows))
    assert dropped(0x1F90) == 10
    assert dropped(0x1F92) == 0


class Fuzzed(OperatedCell):
    """A fuzzed daemon.

    Attributes:
        memory: Its memory, one value for each measurement; the last one for good.
        dies_after: Number of datagrams after which it answers no more.
        executes_after: Number of datagrams after which it performs a command.
    """

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        super().__init__()
        self.memory = [10_000_000]
        self.dies_after = self.executes_after = 1 << 30
        self.raw = ScriptedRaw(self)
        self.raw.takes = self._take
        monkeypatch.setattr(self.raw, "fence", self._fence)
        monkeypatch.setattr(fuzzing, "open_cell", self._open)
        monkeypatch.setattr(fuzzing, "raw_socket", self.raw.open)
        monkeypatch.setattr(fuzzing, "WARM_UP", 2 * WINDOW)
        monkeypatch.setattr(fuzzing, "dropped", lambda _: 4)
        monkeypatch.setattr(fuzzing, "sample", self._sample)

    @asynccontextmanager
    async def _open(self, *_: Any) -> AsyncIterator[Any]:
        yield self

    def _sample(self, _: int) -> ResourceSample:
        return ResourceSample(self.memory.pop(0) if self.memory[1:] else self.memory[0], 1, 1)

    def _take(self, _: bytes) -> bytes:
        if len(self.raw.sent) == self.executes_after:
            self.client.branches["registration"] = "000"
            self.client.rows.append(row("outcome"))
        return b""

    async def _fence(self) -> list[bytes]:
        await asyncio.sleep(1.0)
        if len(self.raw.sent) > self.dies_after:
            self.process.returncode = 1
            raise Unmet("It does not answer.")
        return [b"1_rejected"]


@pytest.fixture
def fuzzed(monkeypatch: pytest.MonkeyPatch) -> Fuzzed:
    return Fuzzed(monkeypatch)


def fuzzed_with(datagrams: int, seed: int = 1, **more: Any) -> FuzzReport:
    async def run() -> FuzzReport:
        clock = SimulatedClock(asyncio.get_running_loop())
        return await fuzz(datagrams, seed, Path("folder"), clock, **more)

    return run_on_simulated_loop(run())


def test_a_daemon_that_refuses_everything_passes(fuzzed: Fuzzed) -> None:
    shown: list[tuple[str, int, int]] = []
    report = fuzzed_with(250, progress=lambda *each: shown.append(each))
    assert (report.datagrams, report.answers, report.dropped, report.rows) == (250, 3, 4, 0)
    assert not report.violated
    assert len(fuzzed.raw.sent) == 2 * WINDOW + 250, "the warm-up does not count"
    assert shown == [("datagrams", 100, 250), ("datagrams", 200, 250), ("datagrams", 250, 250)]


def test_a_daemon_that_dies_has_crashed(fuzzed: Fuzzed) -> None:
    fuzzed.dies_after = 3 * WINDOW
    report = fuzzed_with(1000)
    assert (report.datagrams, report.crashed, report.violated) == (2 * WINDOW, True, True)


def test_a_command_that_was_performed_is_seen(fuzzed: Fuzzed) -> None:
    fuzzed.executes_after = 3 * WINDOW
    report = fuzzed_with(200)
    assert (report.state_changed, report.rows, report.violated) == (True, 1, True)


def test_memory_is_the_least_of_many_measurements(fuzzed: Fuzzed) -> None:
    many = fuzzing.LOOKS
    fuzzed.memory = [90_000_000] * (many - 1) + [10_000_000] + [90_000_000] * (many - 1) + [15_000_000]
    assert fuzzed_with(100).growth_mb == 5.0
    fuzzed.memory = [10_000_000] * many + [21_000_000]
    assert fuzzed_with(100).violated


def test_a_run_ends_when_its_time_is_over(fuzzed: Fuzzed) -> None:
    assert fuzzed_with(10_000, minutes=0.1).datagrams == 6 * WINDOW
    assert fuzzed.raw.sent


def test_the_same_seed_sends_the_same(fuzzed: Fuzzed) -> None:
    sent = []
    for seed in (1, 1, 2):
        fuzzed.raw.sent.clear()
        fuzzed_with(100, seed)
        sent.append(list(fuzzed.raw.sent))
    assert sent[0] == sent[1] != sent[2]
