"""Recording a real daemon by the command line, playing it on its bus, and exporting its session."""

from __future__ import annotations

import asyncio
import hashlib
import json
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import aclosing, contextmanager
from pathlib import Path

import msgspec
import pytest
from click.testing import CliRunner, Result

from pcmrs.bus import Bus, BusSettings
from pcmrs.bus.codec import unpack
from pcmrs.cli import main
from pcmrs.client import Client
from pcmrs.journal import JournalReader
from pcmrs.messages import DeviceEvent, JointState, Snapshot
from pcmrs.messages.health import Health
from pcmrs.messages.setup import ProcedureDataView
from pcmrs.recording.playback import PlaybackReport
from pcmrs.recording.reader import RecordingReader
from pcmrs.recording.settings import FOLDER
from pcmrs.recording.writer import RecordingReport
from pcmrs.settings import read_settings
from pcmrs.testing.driving import accept, landmarks
from tests.system.daemon.daemon_process import (
    PATIENCE,
    START_TIME,
    ServeProcess,
    as_words,
    own_settings,
    run_pcmrs,
    running_daemon,
    wait_until,
)


@contextmanager
def recorder(daemon: ServeProcess, file: Path, *options: str) -> Iterator[subprocess.Popen[bytes]]:
    """``pcmrs record``, once it has heard the robot; ended with the context if it has not ended by itself."""
    command = [sys.executable, "-m", "pcmrs.cli", "record", str(file), "--json", *options, *as_words(daemon.settings)]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    try:
        assert wait_until(lambda: process.poll() is not None or heard(file, "state/joints"), 60.0)
        yield process
    finally:
        if process.poll() is None:
            process.kill()
        process.communicate()


def heard(file: Path, key: str) -> bool:
    """Whether a file that is being written has a message of this key already."""
    return file.exists() and file.stat().st_size > 8 and key in keys(file)


def keys(file: Path) -> set[str]:
    return {message.key for _, message in RecordingReader(file).bus_messages()}


def ended(process: subprocess.Popen[bytes]) -> RecordingReport:
    """Ends it as Ctrl-C does."""
    process.send_signal(signal.SIGINT)
    output, errors = process.communicate(timeout=START_TIME)
    assert process.returncode == 0, errors.decode()
    return msgspec.json.decode(output, type=RecordingReport)


async def test_recording_is_replayed_unchanged_and_not_at_a_live_cell(daemon: ServeProcess, tmp_path: Path) -> None:
    file = tmp_path / "run.mcap"
    with recorder(daemon, file) as process:
        async with daemon.client() as client:
            await accept(client, "registration.plan_landmarks", **landmarks())
            gathered = await client.gathered()
            await accept(client, "registration.reinit")
        report = ended(process)
    assert report.dropped == 0
    reading = RecordingReader(file)
    recorded = [message for _, message in reading.bus_messages()]
    assert reading.complete
    assert len(recorded) == report.messages
    assert {"state/fsm", "state/flags", "state/event", "state/joints", "state/pose/coil"} <= {m.key for m in recorded}

    assert gathered in [unpack(m.payload, ProcedureDataView) for m in recorded if m.key == "state/data"]
    assert unpack(next(m.payload for m in recorded if m.key == "state/health"), Health).status == "ok"

    snapshots: list[Snapshot] = []
    heard_again: list[JointState] = []
    bus = await Bus.open(BusSettings(endpoint=daemon.ready.endpoint, site="replay", cell="again"))
    try:
        bus.subscribe("state/fsm", Snapshot, lambda _, message: snapshots.append(message))
        bus.subscribe("state/joints", JointState, lambda _, message: heard_again.append(message))
        words = ["play", str(file), "--as", "again", "--rate", "4", "--endpoint", daemon.ready.endpoint, "--json"]
        played = await asyncio.to_thread(run_pcmrs, *words)
        assert played.returncode == 0, played.stderr
        last = [snapshot_of(m.payload) for m in recorded if m.key == "state/fsm"][-1]
        assert await asyncio.to_thread(wait_until, lambda: bool(heard_again) and snapshots[-1:] == [last])
    finally:
        await bus.close()
    told = msgspec.json.decode(played.stdout, type=PlaybackReport)
    assert (told.prefix, told.messages, told.damage) == ("pcmrs/replay/again", len(recorded), [])
    original = [msgspec.msgpack.decode(m.payload, type=JointState) for m in recorded if m.key == "state/joints"]
    assert set(map(id_of, heard_again)) <= set(map(id_of, original))

    site = await Bus.open(BusSettings(endpoint=daemon.ready.endpoint, site="replay", cell="live"))
    try:
        site.alive("daemon")
        refused = await asyncio.to_thread(
            run_pcmrs, "play", str(file), "--as", "live", "--endpoint", daemon.ready.endpoint
        )
    finally:
        await site.close()
    assert refused.returncode == 4
    assert "A daemon runs under pcmrs/replay/live" in refused.stderr


def snapshot_of(payload: bytes) -> Snapshot:
    return msgspec.msgpack.decode(payload, type=Snapshot)


def id_of(state: JointState) -> tuple[float, ...]:
    return (state.captured, *state.positions)


def test_killed_recorder_leaves_a_file_that_is_almost_all_saved(daemon: ServeProcess, tmp_path: Path) -> None:
    file, mended = tmp_path / "run.mcap", tmp_path / "mended.mcap"
    with recorder(daemon, file) as process:
        process.kill()
        process.wait(PATIENCE)
    saved = run_pcmrs("repair", str(file), "-o", str(mended), "--json")
    assert saved.returncode == 0, saved.stderr
    told = json.loads(saved.stdout)
    assert not told["complete"]
    assert told["messages"] > 0
    assert told["lost_bytes"] < 32_768  # the chunk that was being written
    reading = RecordingReader(mended)
    assert len(list(reading.records())) > told["messages"]
    assert reading.complete
    assert pcmrs("repair", str(file), "-o", str(mended)).exit_code == 4


async def test_full_disk_ends_the_recording_and_is_journalled(daemon: ServeProcess, tmp_path: Path) -> None:
    file = tmp_path / "run.mcap"
    command = ["record", str(file), "--keep-free", "1000000GB", *as_words(daemon.settings)]
    ended = await asyncio.to_thread(run_pcmrs, *command)
    assert ended.returncode == 5
    assert "kept for the journal" in ended.stdout

    def journalled() -> bool:
        with JournalReader(Path(daemon.ready.journal)) as reader:
            return any(row.row.operation == "recording_ended" for row in reader.read(kind="device"))

    assert await asyncio.to_thread(wait_until, journalled)
    assert not (await _latched(daemon))


async def _latched(daemon: ServeProcess) -> bool:
    async with daemon.client() as client:
        return (await client.state()).latched


def test_bad_calls_are_refused_before_anything_is_made(tmp_path: Path) -> None:
    there, new = tmp_path / "there.mcap", str(tmp_path / "new.mcap")
    there.touch()
    assert pcmrs("record", str(there)).exit_code == 4
    assert pcmrs("record", new, "--topics", "state/**", "--topics", "state/fsm").exit_code == 4
    assert pcmrs("record", new, "--set", "cell.endpoint=tcp/127.0.0.1:1").exit_code == 3
    assert pcmrs("record", new, "--max-size", "12 apples").exit_code == 2
    assert pcmrs("record", new, "--max-total", "1GB").exit_code == 2
    assert pcmrs("play", str(there)).exit_code == 5
    assert pcmrs("play", str(there), "--from", "3", "--to", "2").exit_code == 2
    assert [path.name for path in tmp_path.iterdir()] == ["there.mcap"]


def pcmrs(*words: str) -> Result:
    """Runs ``pcmrs`` in this process, which has loaded all it needs."""
    return CliRunner().invoke(main, words)


@pytest.mark.nightly
async def test_session_is_recorded_although_its_recorder_is_killed(
    tmp_path: Path,
) -> None:
    """It is exported as one folder."""
    cell, out = tmp_path / "cell", tmp_path / "out"
    cell.mkdir()
    settings = [each for each in own_settings(cell) if not each.startswith("recording.")]

    def files() -> list[Path]:
        return sorted((cell / FOLDER).glob("*.mcap"))

    with running_daemon(settings, tmp_path) as daemon:
        async with daemon.client() as client:
            assert await asyncio.to_thread(wait_until, lambda: any(heard(file, "state/joints") for file in files()), 60)
            restarted = asyncio.create_task(event_of(client, "recording_restarted"))
            await asyncio.sleep(0)  # it listens
            os.kill(recorder_of(daemon), signal.SIGKILL)
            event = await restarted
            assert not event.danger
            assert not (await client.state()).latched
            await accept(client, "registration.reinit")
        second = await asyncio.to_thread(wait_until, lambda: len(files()) == 2 and heard(files()[1], "state/fsm"), 60)
        assert second
        assert daemon.end() == 0
    assert "state/joints" in keys(files()[0])
    whole = RecordingReader(files()[1])
    assert {heard.key for _, heard in whole.bus_messages()} >= {"state/fsm", "state/joints"}
    assert whole.complete
    assert whole.origin["site"] == "test"

    words = as_words(settings)
    exported = run_pcmrs("export-session", "-o", str(out), "--json", *words)
    assert exported.returncode == 0, exported.stdout + exported.stderr
    told = json.loads(exported.stdout)
    assert (told["problems"], told["missing"]) == ([], [])
    assert told["recordings"] == [file.name for file in files()]
    assert told["session"] == whole.origin["session"]
    named = {line.partition("  ")[2]: line.partition("  ")[0] for line in (out / "SHA256SUMS").read_text().splitlines()}
    assert named == {
        path.relative_to(out).as_posix(): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in out.rglob("*")
        if path.is_file() and path.name != "SHA256SUMS"
    }
    with JournalReader(out / "journal.sqlite") as copy:
        assert next(copy.read(kind="config", last=1)).row.session_id == told["session"]
    assert read_settings(out / "configuration.toml") == read_settings(None, settings)
    assert pcmrs("export-session", "-o", str(out), *words).exit_code == 4
    assert pcmrs("export-session", "-o", str(tmp_path / "o"), "--session", "none", *words).exit_code == 5
    assert not (tmp_path / "o").exists()


def recorder_of(daemon: ServeProcess) -> int:
    (pid,) = [pid for pid in daemon.children() if b"--lifeline" in Path(f"/proc/{pid}/cmdline").read_bytes()]
    return pid


async def event_of(client: Client, code: str) -> DeviceEvent:
    """Waits for an event with this code."""
    async with asyncio.timeout(PATIENCE), aclosing(client.watch()) as events:
        async for event in events:
            if isinstance(event, DeviceEvent) and event.code == code:
                return event
    raise AssertionError(f"no {code}")
