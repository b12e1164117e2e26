"""Cost of recording: percent of one processor, compared with a bare Zenoh subscriber to the same messages.

A router in a separate process publishes the messages of a working cell: three tracked bodies at 60 Hz, joints at 100
Hz, a snapshot and a verdict each second. Recorder and bare subscriber receive them at the same time, each in a separate
process; CPU time is user and system time of the process in the middle of its run, without its start. Wall times do not
matter, so a busy machine changes little.

    .venv/bin/python benchmarks/recording.py [--seconds 20] [--json]
"""

from __future__ import annotations

import argparse
import asyncio
import json
import multiprocessing
import os
import platform
import tempfile
import time
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import msgspec
import zenoh

from pcmrs.bus import Bus, BusSettings
from pcmrs.bus.settings import open_session
from pcmrs.clock import SystemClock
from pcmrs.kinematics.arms import ARMS
from pcmrs.messages import BlueprintTag, BodyPose, DeviceEvent, JointState, Snapshot
from pcmrs.recording.series import Limits, files_of
from pcmrs.recording.subscriber import Subscriber
from pcmrs.recording.topics import TOPICS
from pcmrs.recording.views import RecordingViews
from pcmrs.recording.writer import RecordingPlan, RecordingWriter
from pcmrs.testing.daemon import free_port
from pcmrs.workflows.mounting import Mounting
from pcmrs.workflows.settings import CalibrationSettings

ARM = ARMS["iiwa14"]
WARM = 3.0


async def publish(settings: BusSettings, seconds: float) -> int:
    """Publish messages for some time, and return their number.

    Args:
        settings: Settings of the bus.
        seconds: Duration, s.
    """
    bus, clock, count = await Bus.open(settings), SystemClock(), 0
    tag = BlueprintTag(id="b", version="1", hash="0" * 64)
    snapshot = Snapshot(sequence=0, branches={"robot": "1"}, flags={}, running=[], latched=False, blueprint=tag)
    started = clock.monotonic()
    due = {"pose": started, "joints": started, "state": started}
    while (now := clock.monotonic()) < started + seconds:
        if now >= due["pose"]:
            due["pose"] += 1 / 60
            for body in ("coil", "body_ref", "pointer"):
                seen = BodyPose(body=body, frame_number=count, captured=now - 0.03, sent=now, valid=True)
                bus.publish(f"state/pose/{body}", seen)
            count += 3
        if now >= due["joints"]:
            due["joints"] += 1 / 100
            zeros = [0.0] * len(ARM.joints)
            measured = JointState(captured=now, sent=now, positions=list(ARM.home), velocities=zeros, torques=zeros)
            bus.publish("state/joints", measured)
            count += 1
        if now >= due["state"]:
            due["state"] += 1.0
            bus.publish("state/fsm", snapshot)
            bus.publish("state/event", DeviceEvent(device="robot", code="note", text="A line of the log."))
            count += 2
        await clock.sleep(max(0.0, min(due.values()) - clock.monotonic()))
    await bus.close()
    return count


def publisher(settings: BusSettings, seconds: float) -> None:
    """Publish messages for some time.

    Args:
        settings: Settings of the bus.
        seconds: Duration, s.
    """
    asyncio.run(publish(settings, seconds))


def bare(settings: BusSettings, seconds: float, results: Connection) -> None:
    """Count the messages in Zenoh's own threads.

    Args:
        settings: Settings of the bus.
        seconds: Duration, s.
        results: Connection for the result.
    """
    count = 0

    def take(_sample: zenoh.Sample) -> None:
        nonlocal count
        count += 1

    session = open_session(settings)
    session.declare_subscriber(f"pcmrs/{settings.site}/{settings.cell}/**", take)
    time.sleep(WARM)
    before, counted = time.process_time(), count
    time.sleep(seconds)
    used, counted = time.process_time() - before, count - counted
    results.send({"cpu_percent": 100 * used / seconds, "messages": counted})
    os._exit(0)  # the parent has the result, and closing a session takes long


def recorder(settings: BusSettings, seconds: float, results: Connection) -> None:
    """Record into a temporary file.

    Args:
        settings: Settings of the bus.
        seconds: Duration, s.
        results: Connection for the result.
    """
    with tempfile.TemporaryDirectory() as folder:
        results.send(asyncio.run(_record(settings, seconds, Path(folder) / "run.mcap")))


async def _record(settings: BusSettings, seconds: float, file: Path) -> dict[str, float]:
    clock, ended = SystemClock(), asyncio.Event()
    subscriber = await Subscriber.open(settings, TOPICS, clock)
    views = RecordingViews(ARM, Mounting.read(CalibrationSettings()), 1.0)
    writing = RecordingWriter(RecordingPlan(file, Limits(), {}, lambda: files_of(file)), views, clock)
    work = asyncio.create_task(writing.run(subscriber, ended))
    await clock.sleep(WARM)
    before, counted, size = time.process_time(), writing.messages, _size(file)
    await clock.sleep(seconds)
    used, counted = time.process_time() - before, writing.messages - counted
    written = _size(file) - size
    ended.set()
    report = await work
    await subscriber.close()
    return {
        "cpu_percent": 100 * used / seconds,
        "messages": counted,
        "dropped": report.dropped,
        "kB_per_s": written / seconds / 1000,
    }


def _size(file: Path) -> int:
    return file.stat().st_size


def measure(seconds: float) -> dict[str, Any]:
    """Return the results of both, measured at the same time."""
    router = BusSettings(mode="router", endpoint=f"tcp/127.0.0.1:{free_port()}", site="benchmark", cell="recording")
    client = msgspec.structs.replace(router, mode="client")
    spawn = multiprocessing.get_context("spawn")
    source = spawn.Process(target=publisher, args=(router, seconds + 120.0), daemon=True)
    source.start()
    time.sleep(3.0)
    measured, work = {}, []
    for name, target in (("bare subscriber", bare), ("recorder", recorder)):
        receive, send = spawn.Pipe(duplex=False)
        process = spawn.Process(target=target, args=(client, seconds, send), daemon=True)
        process.start()
        work.append((name, process, receive))
    for name, process, receive in work:
        measured[name] = receive.recv()
        process.join()
    source.terminate()
    source.join()
    return measured


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=20.0)
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    measured = measure(options.seconds)
    if options.json:
        print(json.dumps(measured))
        return
    print(
        f"{platform.machine()}, {os.cpu_count()} processors, Python {platform.python_version()}, {options.seconds:g} s"
    )
    for name, values in measured.items():
        print(f"{name:<16}" + "  ".join(f"{key} {value:.1f}" for key, value in values.items()))


if __name__ == "__main__":
    main()
