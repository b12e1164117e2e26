"""Live tours of a cell that is only a dispatcher and dice: all there is to see is seen, and what is wrong shows."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncGenerator, Mapping
from pathlib import Path
from random import Random
from typing import Any, cast

import msgspec
import pytest

import pcmrs
from pcmrs.client import Client, Event
from pcmrs.clock import SystemClock
from pcmrs.dispatcher import Dispatcher, DispatcherListener, ProcedureData, Run
from pcmrs.errors import ConfigurationError, RefusalError, UnknownOutcomeError
from pcmrs.fsm import Blueprint, Closure, load_blueprint
from pcmrs.messages import Command, DeviceEvent, Snapshot, Verdict
from pcmrs_lab.experiment.tours import live
from pcmrs_lab.experiment.tours.arguments import Arguments, read_arguments
from pcmrs_lab.experiment.tours.progress import DECIDED_AT_ONCE
from pcmrs_lab.experiment.tours.rehearsal import NullRecorder, ScriptedSteps, scripted
from pcmrs_lab.experiment.tours.report import TourReport
from pcmrs_lab.experiment.tours.run import tour_live
from tests.support.altered import with_operation

RATMS = load_blueprint(Path(pcmrs.__file__).parent / "workflows" / "ratms.toml")
TURNS = 40
"""Turns of the event loop that a step takes: enough for Stop to come in between."""

QUIET_TURNS = 5 * TURNS
"""Turns of the event loop without a command, after which the coil is seen aligned."""

NOTHING: Mapping[str, Any] = {}

PAYLOADS = ("landmarks", "landmark_index", "surface_points", "surface_name", "tool_pose", "nudge", "press")
ENDED_OTHERWISE = ("rejected", "failed", "unknown")
EMPTY = {payload: cast(dict[str, Any], {}) for payload in PAYLOADS}


class Dice(ScriptedSteps):
    """Checks that refuse now and then, and steps that end as the dice say."""

    def __init__(self, seed: int, refusing: float) -> None:
        self.dispatcher: Dispatcher[None, ProcedureData] | None = None
        self._rng = Random(seed)
        self._refusing = refusing

    def check(self, name: str, _run: Run[None, ProcedureData]) -> None:
        if self._rng.random() < self._refusing:
            raise RefusalError("bad_luck", f"The dice want {name} to refuse.")

    def step(self, _name: str, run: Run[None, ProcedureData]) -> None:
        assert self.dispatcher is not None
        closure = self.dispatcher.procedure.ask(run.command.branch, run.command.operation)
        assert isinstance(closure, Closure)
        outcome = self._rng.choice(list(closure.outcomes))
        run.outcome = None if outcome == "done" else outcome

    async def side_effecting_step(self, name: str, run: Run[None, ProcedureData]) -> None:
        for _ in range(TURNS):
            await asyncio.sleep(0)
        self.step(name, run)
        if run.command.operation == "connect":
            run.post("placement", "locate")


class DiceCell(DispatcherListener):
    """What a live tour needs of a client, without a bus."""

    simulated = True

    def __init__(self, runs: Blueprint, *, outside: bool = True, refusing: float = 0.2, seed: int = 1) -> None:
        dice = Dice(seed, refusing)
        workflow = scripted(runs, dice, outside=outside)
        self.dispatcher = Dispatcher(workflow, None, SystemClock(), NullRecorder(), self._hold)
        self.dispatcher.add_listener(self)
        dice.dispatcher = self.dispatcher
        self._queues: list[asyncio.Queue[Event]] = []
        self._stops: list[asyncio.Task[bool]] = []
        self._hidden = False
        self._calls = 0
        self._watch = asyncio.ensure_future(self._watch_alignment())

    async def call(self, name: str, arguments: Mapping[str, Any], *, id: str, timeout: float) -> Verdict:
        branch, _, operation = name.partition(".")
        command = Command(id=id, branch=branch, operation=operation, source="bus:test", arguments=dict(arguments))
        self._calls += 1
        try:
            async with asyncio.timeout(timeout):
                return await self.dispatcher.submit(command)
        finally:
            self._calls -= 1

    async def state(self, timeout: float) -> Snapshot:
        await asyncio.sleep(0)
        return self.dispatcher.snapshot()

    async def stop(self, timeout: float) -> None:
        self._stops.append(asyncio.ensure_future(self.dispatcher.stop("bus:test")))

    async def request_device(self, device: str, method: str, arguments: Mapping[str, Any] = NOTHING) -> None:
        if not self.simulated:
            raise UnknownOutcomeError(f"{device} does not answer.")
        if method == "cut_robot" and arguments["cut"]:
            await self._report("link_lost", danger=True)
        elif method == "bump_reference" and arguments["offset_in_body_ref"][0] > 0.0:
            await self._report("reference_moved", danger=True)
        elif method == "occlude":
            self._hidden = arguments["hidden"]
            if self._hidden:
                await self._report("outside")

    async def watch(self) -> AsyncGenerator[Event, None]:
        queue: asyncio.Queue[Event] = asyncio.Queue()
        queue.put_nowait(self.dispatcher.snapshot())
        self._queues.append(queue)
        while True:
            yield await queue.get()

    def never_aligned(self) -> None:
        """The coil is hidden for good."""
        self._watch.cancel()

    async def _watch_alignment(self) -> None:
        """Sees the coil aligned once nothing has been asked for a while."""
        while True:
            quiet = 0
            while quiet < QUIET_TURNS:
                await asyncio.sleep(0)
                quiet = 0 if self._calls or not all(stop.done() for stop in self._stops) else quiet + 1
            joint = self.dispatcher.procedure.joint()
            if joint["placement"] in ("placed", "following") and joint["alignment"] == "0" and not self._hidden:
                await self._report("within")

    async def _report(self, code: str, *, danger: bool = False) -> None:
        await self.dispatcher.report(
            DeviceEvent(device="dice", code=code, text=f"The dice report {code}.", danger=danger)
        )

    async def close(self) -> None:
        self._watch.cancel()
        await asyncio.gather(*self._stops)
        await self.dispatcher.close()

    def on_publish(self, event: Event) -> None:
        for queue in self._queues:
            queue.put_nowait(event)

    async def _hold(self, _latch: bool) -> None:
        pass


async def toured(cell: DiceCell, given: Mapping[str, Any] = EMPTY, seconds: float = 60.0) -> TourReport:
    """The report of a tour that expects RATMS of the cell."""
    done: list[int] = []
    try:
        client = cast(Client, cell)
        report, _ = await tour_live(RATMS, client, Arguments(given), 1000, seconds, lambda n, _: done.append(n))
        return report
    finally:
        await cell.close()


NOT_PROVOKED = {"placement.following_lost:done": 2, "placement.force_limit:done": 5, "placement.watching_lost:done": 2}
"""Events that no fault of the scene brings about, and in how many joint states they could come."""


def unaccepted(report: TourReport) -> dict[str, int]:
    """What should have been accepted and was not seen, in how many joint states."""
    found = (left for left in report.left if left.command.partition(":")[2] not in ENDED_OTHERWISE)
    return {left.command: left.joint_states for left in found}


@pytest.mark.nightly
async def test_everything_that_a_cell_can_show_is_seen() -> None:
    report = await toured(DiceCell(RATMS))
    assert report.passed
    assert report.deviations == {"cell": []}
    assert {left.reason for left in report.left} == {live.NEVER_SILENT, live.NO_FAULT}
    missing = {"pairs": 0, "accepted": sum(NOT_PROVOKED.values()), "outcomes": len(NOT_PROVOKED)}
    for key, count in missing.items():
        assert report.coverage[key].covered == report.coverage[key].total - count
    assert unaccepted(report) == NOT_PROVOKED
    assert report.stops > 100


class FirstAcknowledgement(DiceCell):
    """A cell that falls silent at the first acknowledgement."""

    named: Mapping[str, Any] | None = None

    async def call(self, name: str, arguments: Mapping[str, Any], *, id: str, timeout: float) -> Verdict:
        state = self.dispatcher.snapshot()
        if name == "robot.acknowledge" and state.latched:
            self.named = arguments
            assert state.stop.number > 0
            raise UnknownOutcomeError(f"Stop {state.stop.number}")
        return await super().call(name, arguments, id=id, timeout=timeout)


async def test_an_acknowledgement_names_the_stop_that_was_seen() -> None:
    cell = FirstAcknowledgement(RATMS)
    with pytest.raises(UnknownOutcomeError) as silent:
        await toured(cell)
    assert cell.named is not None
    assert silent.value.text == f"Stop {cell.named['stop']}"


@pytest.mark.nightly
async def test_joint_states_that_do_not_come_by_themselves_are_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(live, "REPORTED_WITHIN", 0.01)
    cell = DiceCell(RATMS)
    cell.never_aligned()
    report = await toured(cell)
    assert not report.passed
    assert report.deviations == {"cell": []}
    left = {left.command: left.reason for left in report.left}
    assert left["alignment.within:done"] == live.NOT_REPORTED
    assert left["alignment.outside:done"] == live.NOT_REACHED
    assert report.coverage["pairs"].covered > report.coverage["pairs"].total * 0.9


@pytest.mark.nightly
async def test_command_decided_at_once_is_not_stopped() -> None:
    report = await toured(DiceCell(RATMS, outside=False, refusing=0.0))
    assert report.passed
    failing = {left.reason for left in report.left if left.command.endswith(":failed")}
    assert failing == {DECIDED_AT_ONCE}


@pytest.mark.parametrize(
    ("branch", "operation", "fields"),
    [
        ("placement", "home", {"to": "held"}),
        ("placement", "approach", {"on_failure": "unknown"}),
        ("registration", "clear_registration", {"from_": ["110", "111"]}),
        ("toolplan", "reinit", {"requires": {}}),
    ],
)
@pytest.mark.nightly
async def test_a_cell_that_runs_something_else_deviates(branch: str, operation: str, fields: dict[str, Any]) -> None:
    report = await toured(DiceCell(with_operation(RATMS, branch, operation, **fields)))
    assert not report.passed
    assert any(deviation.command.startswith(f"{branch}.{operation}") for deviation in report.deviations["cell"])


async def test_time_that_is_up_is_no_success() -> None:
    report = await toured(DiceCell(RATMS), seconds=0.0)
    assert not report.passed
    assert report.coverage["pairs"].covered == 0
    assert any(left.reason == live.OUT_OF_TIME for left in report.left)


@pytest.mark.nightly
async def test_operations_without_arguments_are_named() -> None:
    report = await toured(DiceCell(RATMS), {"landmarks": {}, "landmark_index": {}, "tool_pose": {}})
    missing = {left.command for left in report.left if "give nudge with --arguments" in left.reason}
    assert missing == {f"placement.nudge:{ending}" for ending in ("done", "failed", "rejected")}
    assert report.deviations == {"cell": []}


async def test_a_cell_with_another_workflow_is_refused() -> None:
    cell = DiceCell(msgspec.structs.replace(RATMS, hash="0" * 64))
    with pytest.raises(ConfigurationError, match="runs ratms"):
        await toured(cell)


async def test_a_cell_that_is_not_simulated_is_refused() -> None:
    cell = DiceCell(RATMS)
    cell.simulated = False
    with pytest.raises(ConfigurationError, match="simulated"):
        await toured(cell)
    assert cell.dispatcher.snapshot().sequence == 1  # no command but the one that ends it


def test_arguments_are_used_in_turn() -> None:
    arguments = Arguments({"landmark_index": [{"index": 0}, {"index": 1}], "a.b": {"only": True}})
    turns = [arguments.next("d.one", "landmark_index")["index"] for _ in range(4)]
    assert sorted(turns[:2]) == [0, 1]
    assert turns[:2] == turns[2:]
    assert arguments.next("a.b", "landmark_index") == {"only": True}
    assert arguments.next("a.c", "none") == {}


@pytest.mark.parametrize("text", ["[", "nudge = 1", 'nudge = ["x"]', "\ud800"])
def test_arguments_that_cannot_be_read_are_refused(tmp_path: Path, text: str) -> None:
    file = tmp_path / "arguments.toml"
    file.write_bytes(text.encode(errors="surrogatepass"))
    with pytest.raises(ConfigurationError, match="contains no valid arguments"):
        read_arguments(file)
