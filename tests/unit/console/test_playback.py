"""A recording shows at every moment what was known then, whichever way one got there."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import msgspec
import pytest
from hypothesis import HealthCheck, given
from hypothesis import settings as checking
from hypothesis import strategies as st

from pcmrs.bus.codec import pack
from pcmrs.console._cell_view_model import EPOCHS, NOTHING
from pcmrs.console.playback import RATE_HZ, LoadedRecording, Playback, load_recording
from pcmrs.errors import FileFormatError
from pcmrs.fsm import Blueprint
from pcmrs.messages import BlueprintTag, DeviceEvent, Epoch, JointState, Snapshot, Target, Verdict
from pcmrs.messages.health import Health
from pcmrs.messages.setup import LandmarkShown, ProcedureDataView, StimulationShown
from pcmrs.recording.file import RecordingFile, Topics
from pcmrs.recording.series import recordings_in
from pcmrs.service.health.report import report
from pcmrs.workflows import read_workflow
from pcmrs.workflows.data import as_message
from tests.support.health_facts import WELL
from tests.unit.console.shown_cell import body, setup, some_pose
from tests.unit.recording.recording_bench import recording

LENGTH = 20.0
BEGUN_NS = 1_700_000_000 * 10**9
BLUEPRINT: Blueprint = read_workflow("ratms")
START = {name: next(iter(branch.states)) for name, branch in BLUEPRINT.branches.items()}
TAG = BlueprintTag(id="ratms", version="1", hash="0")


def snapshot(sequence: int, tag: BlueprintTag = TAG, **branches: str) -> Snapshot:
    return Snapshot(
        sequence=sequence, branches=START | branches, flags={}, running=[], latched=False, blueprint=tag
    )  # fmt: skip


def joints(angle: float) -> JointState:
    return JointState(captured=0.0, sent=0.0, positions=[angle] * 7, velocities=[], torques=[])


def verdict(number: int) -> Verdict:
    return Verdict(id=str(number), branch="robot", operation="connect", decision="accepted", state="1", sequence=number)


def landmarks(digitized: int) -> ProcedureDataView:
    """Three that are planned, so many of them digitized; with all, they are registered."""
    points = [(0.1 * n, 0.0, 0.0) for n in range(3)]
    return ProcedureDataView(
        landmarks=[
            LandmarkShown(name=f"l{n}", planned=point, digitized=point if n < digitized else None)
            for n, point in enumerate(points)
        ],
        body_ref_from_image=as_message(some_pose(4)) if digitized == len(points) else None,
        stimulation=StimulationShown(intensity=10.0 + digitized, hunt={"pulses": digitized}),
    )


def epoch(pulse: int) -> Epoch:
    return Epoch(pulse=pulse, muscle="fdi", rate_hz=5000.0, start=-0.1, samples=[1e-6 * pulse] * 100)


def health(uptime: float) -> Health:
    return report(msgspec.structs.replace(WELL, uptime=uptime))


def said() -> list[tuple[float, str, Any]]:
    """When, where and what, in order: 100 joints per second, a state every second, events in between."""
    messages: list[tuple[float, str, Any]] = [(n / 100.0, "state/joints", joints(n / 100.0)) for n in range(2001)]
    messages += [(0.5 + n, "state/fsm", snapshot(n, robot=str(n % 2))) for n in range(19)]
    messages += [(0.6 + n, "state/event", verdict(n)) for n in range(19)]
    messages += [
        (3.0, "state/pose/coil", body("coil", some_pose(1))),
        (9.0, "state/pose/coil", body("coil", some_pose(2))),
    ]
    messages += [(4.0, "state/target", Target(plan="p", pose=as_message(some_pose(3))))]
    messages += [(5.0 + n, "state/data", landmarks(n)) for n in range(4)]
    messages += [(10.2 + n, "state/epoch", epoch(n)) for n in range(EPOCHS + 3)]
    messages += [(1.3 + 5.0 * n, "state/health", health(5.0 * n)) for n in range(3)]
    messages += [(7.77, "state/event", DeviceEvent(device="robot", code="late", text="Late."))]
    messages += [(1.0, "dev/robot/state", {"device": "robot"}), (2.0, "cmd/anna/robot/connect", {"arguments": {}})]
    return sorted(messages, key=lambda each: each[0])


def write(path: Path, messages: list[tuple[float, str, Any]]) -> Path:
    topics = Topics()
    file = RecordingFile(path, topics, {"cell": "lab/cell1"})
    for at, key, message in messages:
        topics.write_raw(key, at, pack(message), BEGUN_NS + round(at * 1e9))
    file.close()
    return path


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> LoadedRecording:
    shares: list[float] = []
    found = load_recording([write(tmp_path_factory.mktemp("r") / "run.mcap", said())], shares.append)
    assert shares == sorted(shares)
    return found


@pytest.fixture
def played(recorded: LoadedRecording) -> Callable[[], Playback]:
    return lambda: Playback(recorded, setup(), BLUEPRINT)


def shown(playback: Playback) -> tuple[Any, ...]:
    told = playback.snapshot, playback.data, playback.joints, dict(playback.poses), dict(playback.received)
    return *told, list(playback.events), list(playback.epochs), playback.health


@checking(suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.lists(st.floats(-1.0, LENGTH + 1.0), min_size=1, max_size=6))
def test_every_way_to_a_moment_shows_the_same(played: Callable[[], Playback], moments: list[float]) -> None:
    wandering, straight = played(), played()
    for moment in moments:
        wandering.seek(moment)
    straight.seek(moments[-1])
    assert shown(wandering) == shown(straight)


@given(st.floats(0.0, LENGTH))
@checking(suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_it_is_what_had_come_until_then(played: Callable[[], Playback], moment: float) -> None:
    playback = played()
    playback.seek(moment)
    before = [(key, message) for at, key, message in said() if round(at * 1e9) / 1e9 <= moment]
    states = [message for key, message in before if key == "state/fsm"]
    assert playback.snapshot == (states[-1] if states else None)
    assert [event for _, event in playback.events] == [message for key, message in before if key == "state/event"]
    for key, seen, nothing in (("data", playback.data, NOTHING), ("health", playback.health, None)):
        assert seen == next((message for on, message in reversed(before) if on == f"state/{key}"), nothing)
    assert list(playback.epochs) == [message for key, message in before if key == "state/epoch"][-EPOCHS:]
    assert ("coil" in playback.poses) == (moment >= 3.0)
    assert playback.joints is not None
    assert 0.0 <= moment - playback.joints.positions[0] <= 1.0 / RATE_HZ + 0.011, "thinned, not late"
    age = playback.age("coil")
    assert age is None if moment < 3.0 else age == pytest.approx(moment - (9.0 if moment >= 9.0 else 3.0))


def test_times_are_those_of_the_session(recorded: LoadedRecording, played: Callable[[], Playback]) -> None:
    assert (recorded.started_at, recorded.duration, recorded.damage) == (1_700_000_000.0, LENGTH, "")
    assert len(recorded.tracks["state/joints"].times) <= LENGTH * RATE_HZ + 1
    playback = played()
    playback.seek(1.0)
    assert [at for at, _ in playback.events] == [1_700_000_000.6]


def test_older_recording_shows_plan_and_registration_by_targets(tmp_path: Path) -> None:
    newer = ("state/data", "state/epoch", "state/health")
    path = write(tmp_path / "older.mcap", [each for each in said() if each[1] not in newer])
    playback = Playback(load_recording([path], lambda _: None), setup(), BLUEPRINT)
    playback.seek(LENGTH)
    assert playback.data == ProcedureDataView(landmarks=[], plan=as_message(some_pose(3)))
    assert (list(playback.epochs), playback.health, playback.trouble) == ([], None, "")


async def test_recorded_messages_are_what_is_shown(tmp_path: Path) -> None:
    file = tmp_path / "run.mcap"
    told = [
        ("state/data", landmarks(3)),
        ("state/epoch", epoch(1)),
        ("state/epoch", epoch(2)),
        ("state/health", health(5.0)),
    ]
    async with recording(file) as work:
        before = await work.hears()
        for count, (key, message) in enumerate(told, before + 1):
            work.bus.publish(key, message)
            await work.written(count)
    playback = Playback(load_recording([file], lambda _: None), setup(), BLUEPRINT)
    playback.seek(0.0)
    assert (playback.data, list(playback.epochs), playback.health) == (NOTHING, [], None)
    playback.seek(playback.recorded.duration)
    assert (playback.data, list(playback.epochs), playback.health) == (landmarks(3), [epoch(1), epoch(2)], health(5.0))


def test_recording_that_this_cell_cannot_show_is_refused(tmp_path: Path) -> None:
    other = write(tmp_path / "other.mcap", [(0.0, "state/fsm", snapshot(1, msgspec.structs.replace(TAG, id="x")))])
    older = write(tmp_path / "older.mcap", [(0.0, "state/fsm", snapshot(1, robot="broken"))])
    arm = write(tmp_path / "arm.mcap", [(0.0, "state/joints", msgspec.structs.replace(joints(0.0), positions=[0.0]))])
    for path, what in ((other, "workflow x 1"), (older, "workflow ratms 1"), (arm, "1 joints")):
        with pytest.raises(FileFormatError, match=what):
            Playback(load_recording([path], lambda _: None), setup(), BLUEPRINT)


def test_no_recording_an_empty_one_and_a_cut_one(tmp_path: Path) -> None:
    none, empty = tmp_path / "none.mcap", write(tmp_path / "empty.mcap", [])
    none.write_bytes(b"solid")
    for path in (none, empty):
        with pytest.raises(FileFormatError):
            load_recording([path], lambda _: None)
    cut = write(tmp_path / "cut.mcap", said())
    cut.write_bytes(cut.read_bytes()[:-20_000])
    found = load_recording([cut], lambda _: None)
    assert "cut.mcap" in found.damage
    assert 0.0 < found.duration < LENGTH
    assert found.damage in Playback(found, setup(), BLUEPRINT).trouble


def test_numbered_files_are_one_recording(tmp_path: Path) -> None:
    messages = said()
    second, first = (
        write(tmp_path / f"run.000{n}.mcap", part) for n, part in ((2, messages[900:]), (1, messages[:900]))
    )
    alone = write(tmp_path / "alone.mcap", messages)
    assert recordings_in(tmp_path) == {"alone": [alone], "run": [first, second]}
    joined, whole = (load_recording(files, lambda _: None) for files in ([first, second], [alone]))
    assert (joined.started_at, joined.duration, joined.tracks) == (whole.started_at, whole.duration, whole.tracks)
