"""What a run of the daemon takes over from earlier ones, and a journal that fails while it runs."""

from __future__ import annotations

import asyncio
import json
import time
from collections.abc import AsyncIterator, Callable
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import msgspec
import pytest
from structlog.testing import capture_logs

from pcmrs.authoring.design import design
from pcmrs.clock import SystemClock
from pcmrs.dispatcher import Dispatcher, DispatcherListener
from pcmrs.errors import ConfigurationError, JournalError
from pcmrs.fsm import Blueprint
from pcmrs.fsm.blueprint import MigrationSpec
from pcmrs.fsm.files.load import read_blueprint
from pcmrs.journal import Journal, JournalRow
from pcmrs.messages import BlueprintTag, DeviceEvent, Reason, Verdict
from pcmrs.pki import Approval, Authority, approval_file, approve, read_credentials
from pcmrs.service.restart.recorder import JournalRecorder
from pcmrs.service.restart.recovery import (
    RETRY_AFTER,
    approval_of,
    conclude,
    keep_journal,
    recover,
)
from pcmrs.settings import AccessSettings, CellSettings, Settings
from pcmrs.testing.clock import ManualClock, settle
from pcmrs.workflows.data import PlacementData
from pcmrs.workflows.opening import open_workflow
from tests.support.shipped import shipped_workflow
from tests.unit.authoring.design.step_tables import step, table
from tests.unit.service.restart.earlier_runs import PLANNED, RATMS, TAG, Flaky, command, recorder_of, write

FAILED = Reason(code=JournalError.code, text="The journal cannot be written: disk full.")


MANY = 100
"""More attempts than a disk that is tried now and then sees in a test."""


class Cell:
    """A dispatcher, journal and recorder of which only the failure matters."""

    def __init__(self) -> None:
        self.clock = ManualClock()
        self.broken: Reason | None = None
        self.full = True
        self.reopened = 0
        self.procedure = SimpleNamespace(blueprint=None)
        self.fail: Callable[[], None] = lambda: None
        self._keeping: asyncio.Task[None] | None = None

    def keep(self) -> None:
        everything = cast(Any, self)
        self._keeping = asyncio.create_task(keep_journal(everything, everything, everything, self.clock))

    def add_listener(self, listener: DispatcherListener) -> None:
        self.fail = listener.on_failure

    async def reopen(self) -> int:
        self.reopened += 1
        if self.reopened > MANY:
            await asyncio.Event().wait()  # the manual clock would never come to the end of attempts without a pause
        if self.full:
            raise JournalError("Still full.")
        return 1

    def read_back(self, _blueprint: object) -> Any:
        return SimpleNamespace(begun=())

    async def resume(self, _begun: object) -> None:
        self.broken = None

    async def close(self) -> None:
        if self._keeping is not None:
            self._keeping.cancel()
            with suppress(asyncio.CancelledError):
                await self._keeping


@pytest.fixture
async def cell() -> AsyncIterator[Cell]:
    made = Cell()
    yield made
    await made.close()


@pytest.mark.parametrize("before", [True, False])
async def test_reopening_is_retried_at_intervals_until_it_succeeds(cell: Cell, before: bool) -> None:
    cell.broken = FAILED if before else None
    cell.keep()
    await settle()
    if not before:
        cell.broken = FAILED
        cell.fail()
        await settle()
    assert cell.reopened == 1
    await cell.clock.advance(0.5 * RETRY_AFTER)
    assert cell.reopened == 1
    await cell.clock.advance(3.0 * RETRY_AFTER)
    assert cell.reopened == 4
    cell.full = False
    await cell.clock.advance(RETRY_AFTER)
    assert (cell.reopened, cell.broken) == (5, None)
    await cell.clock.advance(10.0 * RETRY_AFTER)
    assert cell.reopened == 5


@pytest.mark.parametrize("code", ["internal_error", "ending"])
async def test_failure_outside_the_journal_is_left_to_a_restart(cell: Cell, code: str) -> None:
    cell.broken = Reason(code=code, text="Not the disk.")
    cell.keep()
    await settle()
    cell.fail()
    await cell.clock.advance(10.0 * RETRY_AFTER)
    assert cell.reopened == 0


async def test_an_end_without_a_last_row_is_an_end_too(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(_rows: object) -> None:
        raise JournalError("disk full")

    journal = Journal.open(tmp_path / "ratms.sqlite", durable=False)
    recorder = JournalRecorder(journal, ManualClock(), "s1", BlueprintTag(id="", version="", hash=""))
    recorder.read_back(shipped_workflow("ratms").blueprint)
    monkeypatch.setattr(journal, "append", full)
    with capture_logs() as logged:
        await conclude(recorder)
    await journal.close()
    assert [line["event"] for line in logged] == ["no_last_snapshot"]


async def test_a_run_begins_with_what_it_runs_under(journal: Journal, configured: Settings) -> None:
    await recover(journal, recorder_of(journal), shipped_workflow("ratms"), configured)
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
    await recover(journal, earlier, shipped_workflow("ratms"), configured)
    await write(earlier, "toolplan.plan", plan=PLANNED.image_from_coil, plan_id="plan-1", previous_plan=PLANNED)
    recovered = await recover(journal, recorder_of(journal, "s2"), shipped_workflow("ratms"), configured)
    assert recovered.workflow.initial == PlacementData(previous_plan=PLANNED)


async def test_started_command_is_unknown_until_it_is_settled(journal: Journal, configured: Settings) -> None:
    """It stays so over any number of starts."""
    earlier = recorder_of(journal)
    await recover(journal, earlier, shipped_workflow("ratms"), configured)
    await earlier.intent(command("placement.approach"), {"placement": "retracted"})
    for session in ("s2", "s3"):
        recovered = await recover(journal, recorder_of(journal, session), shipped_workflow("ratms"), configured)
        (shown,) = recovered.unknown
        assert (shown.command, shown.source, shown.operation) == ("c1", "bus:local", "approach")
        assert shown.since == ManualClock().wall()
        assert recovered.latched
    last = recorder_of(journal, "s4")
    await recover(journal, last, shipped_workflow("ratms"), configured)
    await write(last, "placement.locate")
    await write(last, "robot.acknowledge")
    recovered = await recover(journal, recorder_of(journal, "s5"), shipped_workflow("ratms"), configured)
    assert (recovered.latched, recovered.unknown) == (False, ())
    outcomes = [stored.row for stored in journal.reader.read(kind="outcome", command_id="c1")]
    assert [row.verdict.decision for row in outcomes if row.verdict] == ["unknown"], "it is closed once"


async def test_activity_that_moved_the_robot_latches_over_all_starts(journal: Journal, configured: Settings) -> None:
    """It is shown, too."""
    earlier = recorder_of(journal)
    await recover(journal, earlier, shipped_workflow("ratms"), configured)
    fields = {"branch": "placement", "state": "following", "command": "c7"}
    begun = DeviceEvent(device="activity:follow_head", code="activity_started", text="", fields=fields)
    await earlier.event(begun, {"placement": "following"})
    for session in ("s2", "s3"):
        recovered = await recover(journal, recorder_of(journal, session), shipped_workflow("ratms"), configured)
        (shown,) = recovered.unknown
        assert (shown.command, shown.source) == ("c7", "activity:follow_head")
        assert (shown.branch, shown.operation) == ("placement", "follow_head")
        assert recovered.latched
    last = recorder_of(journal, "s4")
    await recover(journal, last, shipped_workflow("ratms"), configured)
    await write(last, "placement.locate")
    assert last.kept.unknown == ()
    assert last.kept.latched
    await write(last, "robot.acknowledge")
    assert not last.kept.latched


async def test_journal_of_another_blueprint_is_refused_unchanged(journal: Journal, configured: Settings) -> None:
    other = JournalRecorder(journal, ManualClock(), "s0", BlueprintTag(id="ratms", version="0.1", hash="ab"))
    await other.event(DeviceEvent(device="x", code="y", text=""), {})
    with pytest.raises(ConfigurationError, match="migrations"):
        await recover(journal, recorder_of(journal), shipped_workflow("ratms"), configured)
    assert len(list(journal.reader.read())) == 1


async def test_declared_migration_is_journalled_before_any_decision(journal: Journal, configured: Settings) -> None:
    other = JournalRecorder(journal, ManualClock(), "s0", BlueprintTag(id="ratms", version="0.1", hash="ab"))
    await other.event(DeviceEvent(device="x", code="y", text=""), {})
    declared = MigrationSpec(version="0.1", hash="ab", why="only a deadline changed")
    workflow = replace(shipped_workflow("ratms"), blueprint=msgspec.structs.replace(RATMS, migrations=[declared]))
    await recover(journal, recorder_of(journal), workflow, configured)
    rows = [stored.row for stored in journal.reader.read(after=1)]
    assert [row.operation for row in rows] == ["started", "taken_up"]
    assert rows[-1].result is not None
    assert rows[-1].result["why"] == "only a deadline changed"


async def until(clock: ManualClock, condition: Callable[[], bool]) -> None:
    for _ in range(20):
        await clock.advance(1.0)
        if condition():
            return
    raise AssertionError("it did not come true in 20 s")


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

    shipped = shipped_workflow("ratms")
    registry = replace(
        shipped.registry,
        checks=dict(shipped.registry.checks) | {"plan_reachable": lambda run: None},
        steps=dict(shipped.registry.steps) | {"keep_plan": lambda run: run.keep(plan_id="p", previous_plan=PLANNED)},
    )
    workflow = replace(shipped, registry=registry)
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


@pytest.mark.parametrize("why", ["", " ", "\n\t"])
def test_a_migration_must_say_why(why: str) -> None:
    text = f'id = "x"\nversion = "1"\nmigrations = [{{ version = "0", hash = "aa", why = {json.dumps(why)} }}]\n'
    text += 'branches.lamp = { states = { off = "dark" } }\n'
    blueprint, (finding,) = read_blueprint(text.encode(), "x.toml")
    assert blueprint is None
    assert (finding.code, finding.path) == ("bad_value", ("migrations", "0", "why"))


async def test_values_of_types_of_an_older_program_are_reported(journal: Journal) -> None:
    tag = BlueprintTag(id="lamp", version="1", hash="aa")
    row = JournalRow(
        kind="outcome", wall=0.0, monotonic=0.0, boot_id="b", session_id="s", blueprint=tag,
        branch="registration", operation="register", result={"previous": {"id": 5}},
        verdict=Verdict(id="c", branch="registration", operation="register", decision="accepted", state="", sequence=1),
    )  # fmt: skip
    await journal.append([row])
    recorder = JournalRecorder(journal, ManualClock(), "s2", tag)
    kept = recorder.read_back(Blueprint(id="lamp", version="1.1.0", branches={}, hash="bb"))
    with pytest.raises(JournalError, match=r"ratms\.sqlite.*cell\.folder"):
        recorder.previous(kept, PlacementData())


async def test_the_approval_of_a_draft_is_journalled(journal: Journal, configured: Settings) -> None:
    approval = Approval(
        id="ratms", version="1", hash="ab", migrations="cd", by="anna", at=1.0, certificate="c", signature="s"
    )
    await recover(journal, recorder_of(journal), shipped_workflow("ratms"), configured, approval)
    rows = [stored.row for stored in journal.reader.read()]
    assert [row.operation for row in rows] == ["started", "draft_approved"]
    assert rows[-1].result is not None
    assert rows[-1].result["text"] == "Drafted by a language model, and approved by anna"
    assert (rows[-1].result["hash"], rows[-1].result["signature"]) == ("ab", "s")


@pytest.mark.parametrize("signed", [True, False])
def test_a_draft_needs_an_approval_by_the_register_of_the_cell(signed: bool, tmp_path: Path) -> None:
    now, file = SystemClock().wall(), tmp_path / "drafted.toml"
    origin = {"model": "made", "prompt": "ab", "protocol": "cd", "date": "2026-11-27"}
    file.write_text(design(table(step("a"), provenance=origin)).text)
    authority = Authority.init(tmp_path / "pki", "lab", now)
    for role, name in (("daemon", "cell"), ("operator", "anna")):
        authority.issue(cast(Any, role), name, now, cells=["lab/cell1"], into=tmp_path)
    access = AccessSettings(identity=str(tmp_path / "cell"), register=str(tmp_path / "pki" / "register.json"))
    settings = Settings(workflow=str(file), cell=CellSettings(site="lab", name="cell1"), access=access)
    workflow = open_workflow(str(file))
    if signed:
        approval = approve(workflow.blueprint, read_credentials(tmp_path / "anna", now), now)
        approval_file(file).write_bytes(msgspec.json.encode(approval))
        assert approval_of(workflow, settings, time.time()) == approval
    else:
        with pytest.raises(ConfigurationError, match="nobody has approved it"):
            approval_of(workflow, settings, time.time())
    assert approval_of(shipped_workflow("ratms"), Settings(), 0.0) is None
