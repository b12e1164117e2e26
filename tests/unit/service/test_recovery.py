"""What a run of the daemon takes over from the rows of earlier ones, and a journal that fails while it runs."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pcmrs.dispatcher import Dispatcher
from pcmrs.dispatcher.events import NOT_CONFIRMED, SHUTDOWN
from pcmrs.errors import ConfigurationError, JournalError
from pcmrs.fsm.blueprint import MigrationSpec
from pcmrs.journal import Journal, JournalRow, journal_files
from pcmrs.journal import writer as writer_module
from pcmrs.messages import BlueprintTag, Command, Decision, DeviceEvent, PoseMessage, Reason, Verdict
from pcmrs.service.restart import recorder as recorder_module
from pcmrs.service.restart.recorder import JournalRecorder
from pcmrs.service.restart.recovery import keep_journal, recover
from pcmrs.service.restart.state import PersistedState, RestartState
from pcmrs.settings import Settings, read_settings
from pcmrs.testing.clock import ManualClock, settle
from pcmrs.workflows.data import PlacementData, Planned
from pcmrs.workflows.opening import open_workflow
from tests.support.trials import examples

WORKFLOW = open_workflow("ratms")
RATMS = WORKFLOW.blueprint
TAG = BlueprintTag(id=RATMS.id, version=RATMS.version, hash=RATMS.hash)
PLANNED = Planned(
    id="plan-1",
    image_from_coil=PoseMessage(position=(0.0, 0.1, 0.2), quat_wxyz=(1.0, 0.0, 0.0, 0.0)),
    patient="phantom",
    calibration="c",
)


@pytest.fixture
async def journal(tmp_path: Path) -> AsyncIterator[Journal]:
    opened = Journal.open(tmp_path / "ratms.sqlite", durable=False)
    yield opened
    await opened.close()


@pytest.fixture(scope="module")
def configured() -> Settings:
    return read_settings()


def recorder_of(journal: Journal, session: str = "s1") -> JournalRecorder:
    return JournalRecorder(journal, ManualClock(), session, TAG)


def command(name: str, number: int = 1) -> Command:
    branch, operation = name.split(".")
    return Command(id=f"c{number}", branch=branch, operation=operation, source="bus:local")


def verdict(of: Command, decision: Decision = "accepted") -> Verdict:
    return Verdict(id=of.id, branch=of.branch, operation=of.operation, decision=decision, state="", sequence=1)


async def write(recorder: JournalRecorder, name: str, decision: Decision = "accepted", **changes: Any) -> None:
    of = command(name, next(NUMBERS))
    await recorder.decision(of, verdict(of, decision), {}, changes, with_intent=True)


NUMBERS = iter(range(1000, 10**9))


# -- the ledger ----------------------------------------------------------------------------------------------------

STARTED = ("config", "daemon.started", None, None)
NAMES = [
    "placement.approach",
    "placement.locate",
    "placement.reinit",
    "robot.connect",
    "robot.acknowledge",
    "toolplan.plan",
]
ROWS = st.lists(
    st.one_of(
        st.tuples(st.just("intent"), st.sampled_from(NAMES), st.integers(0, 5), st.none()),
        st.tuples(
            st.just("outcome"),
            st.sampled_from(NAMES),
            st.integers(0, 5),
            st.sampled_from(["accepted", "rejected", "failed", "unknown", "ended"]),
        ),
        st.tuples(st.just("device"), st.sampled_from(["tracker.lost", "shutdown.stopped"]), st.booleans(), st.none()),
        st.tuples(
            st.just("activity"),
            st.sampled_from(["started", "ended"]),
            st.integers(0, 5),
            st.sampled_from(["placed", "following", "guided"]),
        ),
        st.tuples(st.just("config"), st.just("daemon.started"), st.none(), st.none()),
    ),
    max_size=30,
)


def as_row(kind: str, name: str, number: Any, decision: str | None) -> JournalRow:
    common: dict[str, Any] = {"wall": 5.0, "monotonic": 1.0, "boot_id": "b", "session_id": "s", "blueprint": TAG}
    if kind == "activity":
        fields = {"branch": "placement", "state": decision, "command": f"c{number}"}
        source = f"activity:{RATMS.branches['placement'].activities[decision or ''].run}"
        result = {"danger": False, "fields": fields}
        return JournalRow(kind="device", source=source, operation=f"activity_{name}", result=result, **common)
    branch, operation = name.split(".")
    if kind == "config":
        return JournalRow(kind="config", source=branch, operation=operation, **common)
    if kind == "device":
        return JournalRow(kind="device", source=branch, operation=operation, result={"danger": number}, **common)
    common |= {"source": "x", "command_id": f"c{number}", "branch": branch, "operation": operation}
    if kind == "intent":
        return JournalRow(kind="intent", states={branch: "s"}, **common)
    reason = Reason(code="daemon_ended", text="") if decision == "ended" else None
    made: Any = "unknown" if decision == "ended" else decision
    found = Verdict(
        id=f"c{number}", branch=branch, operation=operation, decision=made, state="", sequence=1, reason=reason
    )
    changes = {"previous_plan": msgspec.json.decode(msgspec.json.encode(PLANNED))} if name == "toolplan.plan" else None
    return JournalRow(kind="outcome", verdict=found, result=changes, **common)


@examples(60)
@given(rows=ROWS, data=st.data())
def test_reading_on_from_any_snapshot_equals_reading_everything(rows: list[Any], data: st.DataObject) -> None:
    made = [as_row(*row) for row in rows]
    cut = data.draw(st.integers(0, len(made)))
    whole, before = RestartState(RATMS, PersistedState()), RestartState(RATMS, PersistedState())
    for row in made:
        whole.take(row)
    for row in made[:cut]:
        before.take(row)
    stored = msgspec.convert(msgspec.msgpack.decode(msgspec.msgpack.encode(before.kept)), PersistedState)
    after = RestartState(RATMS, stored)
    for row in made[cut:]:
        after.take(row)
    assert after.kept == whole.kept


@pytest.mark.parametrize(
    ("rows", "latched"),
    [
        ([("device", "operator.stopped", True, None)], True),
        ([("device", "tracker.slow", False, None)], False),
        ([("device", f"{SHUTDOWN}.stopped", True, None)], False),
        ([("device", "operator.stopped", True, None), ("device", f"{SHUTDOWN}.stopped", True, None)], True),
        ([("device", "operator.stopped", True, None), ("outcome", "robot.acknowledge", 1, "accepted")], False),
        ([("device", "operator.stopped", True, None), ("outcome", "robot.acknowledge", 1, "rejected")], True),
        ([("device", "operator.stopped", True, None), ("outcome", "robot.connect", 1, "accepted")], True),
        ([("intent", "placement.approach", 1, None), ("outcome", "placement.approach", 1, "ended")], True),
        ([("intent", "robot.connect", 1, None), ("outcome", "robot.connect", 1, "ended")], False),
        ([("activity", "started", 1, "following"), STARTED], True),
        ([("activity", "started", 1, "guided"), STARTED], True),
        ([("activity", "started", 1, "placed"), STARTED], False),
        ([("activity", "started", 1, "following"), ("activity", "ended", 1, "following"), STARTED], False),
        ([("activity", "started", 2, "following"), ("activity", "ended", 1, "following"), STARTED], True),
        (
            [
                ("activity", "started", 1, "guided"),
                ("device", "operator.stopped", True, None),
                ("outcome", "robot.acknowledge", 1, "accepted"),
                STARTED,
            ],
            False,
        ),
        ([("activity", "started", 1, "guided"), ("outcome", "robot.acknowledge", 1, "accepted"), STARTED], True),
        ([("activity", "started", 1, "guided"), STARTED, ("outcome", "robot.acknowledge", 1, "accepted")], False),
    ],
)
def test_latch_outlives_a_run_until_it_is_acknowledged(rows: list[Any], latched: bool) -> None:
    ledger = RestartState(RATMS, PersistedState())
    for row in rows:
        ledger.take(as_row(*row))
    assert ledger.kept.latched == latched


def after_an_unsure_end(robot: str) -> PersistedState:
    """Ledger after an orderly end with the robot in this state, which did not confirm that it stood."""
    ledger = RestartState(RATMS, PersistedState())
    ledger.take(as_row("device", f"{SHUTDOWN}.stopped", True, None))
    unsure = as_row("device", f"{SHUTDOWN}.{NOT_CONFIRMED}", True, None)
    ledger.take(msgspec.structs.replace(unsure, states={"robot": robot}))
    return ledger.kept


def test_robot_not_seen_at_rest_at_an_orderly_end_is_latched() -> None:
    """It was connected."""
    assert after_an_unsure_end(robot="1").latched


def test_robot_not_connected_at_an_orderly_end_is_not_latched() -> None:
    assert not after_an_unsure_end(robot="0").latched


# -- the start of a run --------------------------------------------------------------------------------------------


async def test_a_run_begins_with_what_it_runs_under(journal: Journal, configured: Settings) -> None:
    await recover(journal, recorder_of(journal), WORKFLOW, configured)
    (stored,) = journal.reader.read()
    row = stored.row
    assert (row.kind, row.operation) == ("config", "started")
    assert row.result is not None
    assert msgspec.convert(row.result["settings"], Settings) == configured
    assert set(row.result["versions"]) == {"pcmrs", "python"}
    assert len(row.result["calibration"]) == 16


async def test_plan_of_an_earlier_run_can_be_taken_back(journal: Journal, configured: Settings) -> None:
    """It is not in force before."""
    earlier = recorder_of(journal)
    await recover(journal, earlier, WORKFLOW, configured)
    await write(earlier, "toolplan.plan", plan=PLANNED.image_from_coil, plan_id="plan-1", previous_plan=PLANNED)
    recovered = await recover(journal, recorder_of(journal, "s2"), WORKFLOW, configured)
    assert recovered.workflow.initial == PlacementData(previous_plan=PLANNED)


async def test_started_command_is_unknown_until_it_is_settled(journal: Journal, configured: Settings) -> None:
    """It stays so over any number of starts."""
    earlier = recorder_of(journal)
    await recover(journal, earlier, WORKFLOW, configured)
    await earlier.intent(command("placement.approach"), {"placement": "retracted"})
    for session in ("s2", "s3"):
        recovered = await recover(journal, recorder_of(journal, session), WORKFLOW, configured)
        (shown,) = recovered.unknown
        assert (shown.command, shown.source, shown.operation) == ("c1", "bus:local", "approach")
        assert shown.since == ManualClock().wall()
        assert recovered.latched
    last = recorder_of(journal, "s4")
    await recover(journal, last, WORKFLOW, configured)
    await write(last, "placement.locate")
    await write(last, "robot.acknowledge")
    recovered = await recover(journal, recorder_of(journal, "s5"), WORKFLOW, configured)
    assert (recovered.latched, recovered.unknown) == (False, ())
    outcomes = [stored.row for stored in journal.reader.read(kind="outcome", command_id="c1")]
    assert [row.verdict.decision for row in outcomes if row.verdict] == ["unknown"], "it is closed once"


async def test_activity_that_moved_the_robot_latches_over_all_starts(journal: Journal, configured: Settings) -> None:
    """It is shown, too."""
    earlier = recorder_of(journal)
    await recover(journal, earlier, WORKFLOW, configured)
    fields = {"branch": "placement", "state": "following", "command": "c7"}
    begun = DeviceEvent(device="activity:follow_head", code="activity_started", text="", fields=fields)
    await earlier.event(begun, {"placement": "following"})
    for session in ("s2", "s3"):
        recovered = await recover(journal, recorder_of(journal, session), WORKFLOW, configured)
        (shown,) = recovered.unknown
        assert (shown.command, shown.source) == ("c7", "activity:follow_head")
        assert (shown.branch, shown.operation) == ("placement", "follow_head")
        assert recovered.latched
    last = recorder_of(journal, "s4")
    await recover(journal, last, WORKFLOW, configured)
    await write(last, "placement.locate")
    assert last.kept.unknown == ()
    assert last.kept.latched
    await write(last, "robot.acknowledge")
    assert not last.kept.latched


async def test_snapshot_is_in_the_commit_of_every_thousandth_row(
    journal: Journal, configured: Settings, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Reading continues from it."""
    monkeypatch.setattr(recorder_module, "SNAPSHOT_EVERY", 10)
    recorder = recorder_of(journal)
    await recover(journal, recorder, WORKFLOW, configured)
    await write(recorder, "toolplan.plan", previous_plan=PLANNED)
    await recorder.intent(command("robot.connect", 77), {"robot": "0"})
    for _ in range(20):
        await write(recorder, "registration.clear_landmarks", "rejected")
    assert [stored.sequence for stored in journal.reader.read(kind="snapshot")] == [11, 22, 33, 44]
    kept = recorder_of(journal, "s2").read_back(RATMS)
    assert [each.command for each in kept.begun] == ["c77"]
    assert list(kept.taken_back) == ["previous_plan"]


async def test_state_is_carried_over_from_an_earlier_journal_file(
    tmp_path: Path, configured: Settings, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(writer_module, "_CHECKPOINT_AFTER", 4)
    path = tmp_path / "grown.sqlite"
    journal = Journal.open(path, durable=False, largest=1.0)
    recorder = recorder_of(journal)
    await recover(journal, recorder, WORKFLOW, configured)
    await write(recorder, "toolplan.plan", previous_plan=PLANNED)
    await recorder.event(DeviceEvent(device="robot", code="force_limit", text="", danger=True), {})
    await recorder.intent(command("robot.connect", 77), {"robot": "0"})
    for _ in range(10):
        await write(recorder, "registration.clear_landmarks", "rejected")
    await journal.close()
    assert len(journal_files(path)) > 2

    again = Journal.open(path, durable=False)
    recovered = await recover(again, recorder_of(again, "s2"), WORKFLOW, configured)
    await again.close()
    assert recovered.latched
    assert [each.command for each in recovered.unknown] == ["c77"]
    assert recovered.workflow.initial.previous_plan == PLANNED


async def test_an_orderly_end_leaves_a_snapshot_as_the_last_row(journal: Journal, configured: Settings) -> None:
    recorder = recorder_of(journal)
    await recover(journal, recorder, WORKFLOW, configured)
    await recorder.conclude()
    (last,) = journal.reader.read(last=1)
    assert (last.row.kind, last.row.operation) == ("snapshot", "snapshot")
    assert last.row.result is not None
    assert {"data", "taken_back", "latched", "sequence"} <= set(last.row.result)


async def test_journal_of_another_blueprint_is_refused_unchanged(journal: Journal, configured: Settings) -> None:
    other = JournalRecorder(journal, ManualClock(), "s0", BlueprintTag(id="ratms", version="0.1", hash="ab"))
    await other.event(DeviceEvent(device="x", code="y", text=""), {})
    with pytest.raises(ConfigurationError, match="migrations"):
        await recover(journal, recorder_of(journal), WORKFLOW, configured)
    assert len(list(journal.reader.read())) == 1


async def test_declared_migration_is_journalled_before_any_decision(journal: Journal, configured: Settings) -> None:
    other = JournalRecorder(journal, ManualClock(), "s0", BlueprintTag(id="ratms", version="0.1", hash="ab"))
    await other.event(DeviceEvent(device="x", code="y", text=""), {})
    declared = MigrationSpec(version="0.1", hash="ab", why="only a deadline changed")
    workflow = replace(WORKFLOW, blueprint=msgspec.structs.replace(RATMS, migrations=[declared]))
    await recover(journal, recorder_of(journal), workflow, configured)
    rows = [stored.row for stored in journal.reader.read(after=1)]
    assert [row.operation for row in rows] == ["started", "taken_up"]
    assert rows[-1].result is not None
    assert rows[-1].result["why"] == "only a deadline changed"


def test_only_what_explicit_operations_use_is_taken_back() -> None:
    ledger = RestartState(RATMS, PersistedState())
    row = as_row("outcome", "toolplan.plan", 1, "accepted")
    assert row.result is not None
    ledger.take(msgspec.structs.replace(row, result={**row.result, "plan_id": "p", "registration_id": "r"}))
    assert ledger.kept.taken_back == row.result


async def test_snapshot_of_an_unknown_kind_is_reported_with_the_file(journal: Journal) -> None:
    row = as_row("intent", "robot.connect", 1, None)
    await journal.append([msgspec.structs.replace(row, kind="snapshot", result={"latched": "perhaps"})])
    with pytest.raises(JournalError, match=r"ratms\.sqlite.*cell\.folder"):
        recorder_of(journal).read_back(RATMS)


# -- a journal that fails in operation -----------------------------------------------------------------------------


class Flaky:
    """A journal whose disk fails when told to; what was handed to it then is lost, or reaches the disk after all."""

    def __init__(self, journal: Journal) -> None:
        self.reader = journal.reader
        self.failing: str | None = None
        self.reopened = 0
        self._journal = journal

    def append(self, rows: list[JournalRow]) -> asyncio.Future[int]:
        durable: asyncio.Future[int] = asyncio.get_running_loop().create_future()
        if self.failing != "lost":
            self._journal.append(rows)
        if self.failing is None:
            durable.set_result(1)
        else:
            durable.set_exception(JournalError("The journal cannot be written: disk full."))
        return durable

    async def reopen(self) -> int:
        self.reopened += 1
        if self.failing is not None:
            raise JournalError("Still full.")
        return 1


async def until(clock: ManualClock, condition: Callable[[], bool]) -> None:
    for _ in range(20):
        await clock.advance(1.0)
        if condition():
            return
    raise AssertionError("it did not come true in 20 s")


async def test_a_snapshot_never_has_what_the_disk_has_lost(
    journal: Journal, configured: Settings, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(recorder_module, "SNAPSHOT_EVERY", 10)
    flaky: Any = Flaky(journal)
    recorder = JournalRecorder(flaky, ManualClock(), "s1", TAG)
    await recover(flaky, recorder, WORKFLOW, configured)
    flaky.failing = "lost"
    with pytest.raises(JournalError):
        await write(recorder, "toolplan.plan", previous_plan=PLANNED)
    flaky.failing = None
    for _ in range(20):  # before it has been read back
        await write(recorder, "registration.clear_landmarks", "rejected")
    await recorder.conclude()
    assert list(journal.reader.read(kind="snapshot")) == []
    assert recorder.read_back(RATMS).taken_back == {}
    await recorder.conclude()
    (snapshot,) = journal.reader.read(kind="snapshot")
    assert snapshot.row.result is not None
    assert snapshot.row.result["taken_back"] == {}


@pytest.mark.parametrize(("way", "state"), [("lost", "0"), ("written", "1")])
async def test_after_a_failure_the_procedure_is_what_the_disk_says(
    journal: Journal, configured: Settings, way: str, state: str
) -> None:
    """`toolplan.plan` was accepted while the disk failed; what is in force then is what a restart would read."""
    flaky: Any = Flaky(journal)
    recorder = JournalRecorder(flaky, ManualClock(), "s1", TAG)
    clock = ManualClock()

    async def hold(_latch: bool) -> None:
        return None

    workflow = open_workflow("ratms")
    workflow.registry.checks["plan_reachable"] = lambda run: None
    workflow.registry.steps["keep_plan"] = lambda run: run.keep(plan_id="p", previous_plan=PLANNED)
    recovered = await recover(flaky, recorder, workflow, configured)
    cell: Any = None
    dispatcher = Dispatcher(recovered.workflow, cell, clock, recorder, hold)
    recovered.give_to(dispatcher, journal)
    recorder.attach(dispatcher.procedure)
    keeping = asyncio.create_task(keep_journal(flaky, recorder, dispatcher, clock))
    await settle()
    flaky.failing = way
    pose = {"position": [0.0, 0.1, 0.1], "quat_xyzw": [0.0, 0.0, 0.0, 1.0]}
    asked = msgspec.structs.replace(command("toolplan.plan"), arguments=pose)
    assert (await dispatcher.submit(asked)).decision == "unknown"
    assert dispatcher.broken is not None
    await until(clock, lambda: flaky.reopened > 2)
    assert dispatcher.broken is not None
    flaky.failing = None
    await until(clock, lambda: dispatcher.broken is None)
    assert dispatcher.snapshot().branches["toolplan"] == state
    assert dispatcher.snapshot().latched
    again = recorder_of(journal, "s2").read_back(RATMS)
    assert bool(again.taken_back) == (state == "1")
    assert again.latched
    keeping.cancel()
    await dispatcher.close()
