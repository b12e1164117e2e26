"""What the daemon journals, and what it makes of an earlier run that ended in the middle."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import msgspec
import pytest

from pcmrs.dispatcher.events import EarlierDecision
from pcmrs.errors import JournalError
from pcmrs.journal import Journal, JournalRow, journal_files
from pcmrs.journal import writer as writer_module
from pcmrs.messages import BlueprintTag, Command, DeviceEvent, PoseMessage, Verdict
from pcmrs.service.restart import recorder as recorder_module
from pcmrs.service.restart.recorder import JournalRecorder
from pcmrs.service.restart.recovery import recover
from pcmrs.settings import Settings
from pcmrs.testing.clock import ManualClock
from pcmrs.workflows import read_workflow
from pcmrs.workflows.data import Landmark, PlacementData, Registered
from tests.support.shipped import shipped_workflow
from tests.unit.service.restart.earlier_runs import PLANNED, Flaky, as_row, command, recorder_of, write

TAG = BlueprintTag(id="ratms", version="1.0.0", hash="abc")


COMMAND = Command(
    id="c1", branch="placement", operation="approach", source="udp:planner", arguments={"speed": 0.5}, parent="c0"
)


RATMS = read_workflow("ratms")


STATES = {"robot": "1", "placement": "retracted"}


def _recorder(journal: Journal, session: str = "s1") -> JournalRecorder:
    return JournalRecorder(journal, ManualClock(), session, TAG)


def _rows(journal: Journal) -> list[JournalRow]:
    return [stored.row for stored in journal.reader.read(after=0)]


def _verdict(decision: str = "accepted") -> Verdict:
    return Verdict(id="c1", branch="placement", operation="approach", decision=decision, state="standoff", sequence=3)  # type: ignore[arg-type]


async def test_a_row_holds_all_that_is_needed_to_decide_again(journal: Journal) -> None:
    recorder = _recorder(journal)
    pose = PoseMessage(position=(0.0, 0.1, 0.2), quat_wxyz=(1.0, 0.0, 0.0, 0.0))
    await recorder.intent(COMMAND, STATES)
    await recorder.decision(COMMAND, _verdict(), STATES, {"plan": pose}, with_intent=False)
    intent, outcome = _rows(journal)
    assert (intent.kind, outcome.kind) == ("intent", "outcome")
    for row in (intent, outcome):
        assert (row.command_id, row.source, row.parent) == ("c1", "udp:planner", "c0")
        assert (row.branch, row.operation, row.arguments) == ("placement", "approach", {"speed": 0.5})
        assert row.states == STATES
        assert (row.session_id, row.blueprint) == ("s1", TAG)
        assert row.boot_id
        assert row.wall == ManualClock().wall()
        assert row.monotonic == ManualClock().monotonic()
    assert outcome.verdict == _verdict()
    assert outcome.result == {"plan": {"position": [0.0, 0.1, 0.2], "quat_wxyz": [1.0, 0.0, 0.0, 0.0]}}


async def test_intent_and_outcome_may_share_a_commit(journal: Journal) -> None:
    await _recorder(journal).decision(COMMAND, _verdict(), STATES, {}, with_intent=True)
    assert [row.kind for row in _rows(journal)] == ["intent", "outcome"]


async def test_device_events_are_journalled_with_their_values(journal: Journal) -> None:
    event = DeviceEvent(device="robot", code="link_lost", text="Silent.", danger=True, fields={"silence": 1.2})
    await _recorder(journal).event(event, STATES)
    (row,) = _rows(journal)
    assert (row.kind, row.source, row.operation) == ("device", "robot", "link_lost")
    assert row.result == {"text": "Silent.", "danger": True, "fields": {"silence": 1.2}}


async def test_verdict_is_recalled_by_source_and_id_from_earlier_runs(journal: Journal) -> None:
    await _recorder(journal, "s1").decision(COMMAND, _verdict(), STATES, {}, with_intent=True)
    later = _recorder(journal, "s2")
    assert later.recall("udp:planner", "c1") == EarlierDecision(_verdict(), COMMAND.arguments)
    assert later.recall("bus:local", "c1") is None
    assert later.recall("udp:planner", "c2") is None


async def test_new_command_is_known_as_new_without_reading_the_disk(
    journal: Journal, monkeypatch: pytest.MonkeyPatch
) -> None:
    await _recorder(journal, "s1").decision(COMMAND, _verdict(), STATES, {}, with_intent=True)
    recorder = _recorder(journal, "s2")
    own = Command(id="c2", branch="robot", operation="connect", source="bus:local")
    await recorder.decision(own, _verdict(), STATES, {}, with_intent=True)

    def read(*_: str) -> None:
        raise JournalError("The disk does not answer.")

    monkeypatch.setattr(journal.reader, "outcome_of", read)
    assert recorder.recall("udp:planner", "c3") is None
    for source, known in (("udp:planner", "c1"), ("bus:local", "c2")):
        with pytest.raises(JournalError):
            recorder.recall(source, known)


async def test_unfinished_command_of_a_run_is_closed_as_unknown_once(journal: Journal) -> None:
    earlier = _recorder(journal, "s1")
    await earlier.intent(COMMAND, STATES)
    finished = Command(id="c9", branch="robot", operation="connect", source="bus:local")
    await earlier.intent(finished, STATES)
    done = Verdict(id="c9", branch="robot", operation="connect", decision="accepted", state="1", sequence=4)
    await earlier.decision(finished, done, STATES, {}, with_intent=False)
    later = _recorder(journal, "s2")
    (unknown,) = await later.close_unfinished(later.read_back(RATMS).begun)
    assert (unknown.id, unknown.decision, unknown.state) == ("c1", "unknown", "retracted")
    assert unknown.reason is not None
    assert unknown.reason.code == "daemon_ended"
    assert later.recall("udp:planner", "c1") == EarlierDecision(unknown, COMMAND.arguments)
    assert _recorder(journal, "s3").read_back(RATMS).begun == ()


async def test_last_registration_can_be_taken_back_after_a_restart(journal: Journal) -> None:
    landmarks = (Landmark("nasion", (0.0, 0.1, 0.0)),)
    registered = Registered(
        id="r1",
        body_ref_from_image=PoseMessage(position=(0.0, 0.0, 0.1), quat_wxyz=(1.0, 0.0, 0.0, 0.0)),
        residual=0.002,
        rms=0.002,
        landmarks=landmarks,
        digitized=((0.0, 0.1, 0.1),),
        patient="phantom",
        calibration="c",
    )
    first = _recorder(journal)
    assert first.previous(first.read_back(RATMS), PlacementData()) == PlacementData()
    register = msgspec.structs.replace(COMMAND, branch="registration", operation="register")
    changes = {"previous": registered, "registered": registered, "registration_id": "r1"}
    await _recorder(journal).decision(register, _verdict(), STATES, changes, with_intent=True)
    later = _recorder(journal, "s2")
    taken = later.previous(later.read_back(RATMS), PlacementData())
    assert taken == PlacementData(previous=registered), "and nothing is in force"


async def test_snapshot_is_in_the_commit_of_every_thousandth_row(
    journal: Journal, configured: Settings, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Reading continues from it."""
    monkeypatch.setattr(recorder_module, "SNAPSHOT_EVERY", 10)
    recorder = recorder_of(journal)
    await recover(journal, recorder, shipped_workflow("ratms"), configured)
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
    await recover(journal, recorder, shipped_workflow("ratms"), configured)
    await write(recorder, "toolplan.plan", previous_plan=PLANNED)
    await recorder.event(DeviceEvent(device="robot", code="force_limit", text="", danger=True), {})
    await recorder.intent(command("robot.connect", 77), {"robot": "0"})
    for _ in range(10):
        await write(recorder, "registration.clear_landmarks", "rejected")
    await journal.close()
    assert len(journal_files(path)) > 2

    again = Journal.open(path, durable=False)
    recovered = await recover(again, recorder_of(again, "s2"), shipped_workflow("ratms"), configured)
    await again.close()
    assert recovered.latched
    assert [each.command for each in recovered.unknown] == ["c77"]
    assert recovered.workflow.initial.previous_plan == PLANNED


async def test_an_orderly_end_leaves_a_snapshot_as_the_last_row(journal: Journal, configured: Settings) -> None:
    recorder = recorder_of(journal)
    await recover(journal, recorder, shipped_workflow("ratms"), configured)
    await recorder.conclude()
    (last,) = journal.reader.read(last=1)
    assert (last.row.kind, last.row.operation) == ("snapshot", "snapshot")
    assert last.row.result is not None
    assert {"data", "taken_back", "latched", "sequence"} <= set(last.row.result)


async def test_snapshot_of_an_unknown_kind_is_reported_with_the_file(journal: Journal) -> None:
    row = as_row("intent", "robot.connect", 1, None)
    await journal.append([msgspec.structs.replace(row, kind="snapshot", result={"latched": "perhaps"})])
    with pytest.raises(JournalError, match=r"ratms\.sqlite.*cell\.folder"):
        recorder_of(journal).read_back(RATMS)


async def test_a_snapshot_never_has_what_the_disk_has_lost(
    journal: Journal, configured: Settings, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(recorder_module, "SNAPSHOT_EVERY", 10)
    flaky: Any = Flaky(journal)
    recorder = JournalRecorder(flaky, ManualClock(), "s1", TAG)
    await recover(flaky, recorder, shipped_workflow("ratms"), configured)
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
