"""Pose streams at the clients that show them: rate, jitter between frames, age of the pose; compared with a bare timer.

A daemon with the simulated cell in real time streams the tool's pose to a client like 3D Slicer (UDP, `visualization`)
and to one like Unity (`mixed_reality`), while the tool is placed and withdrawn repeatedly. Each client is a separate
process; arrivals are the kernel's stamps. Jitter is the difference between an interval of two arrivals and the
requested one. A pose is identified by its text among those of the tracker on the bus; its age runs from the exposure to
the arrival, so it has the tracker's own latency and rate in it. `bare` is a process that does nothing but send as many
datagrams by `time.sleep`. The paper's stream has 60 Hz. Everything shares the machine's processors, and all is
simulated.

    .venv/bin/python benchmarks/visualization.py [--rates 60 100 250 500] [--seconds 15] [--tracker-hz 60] [--json]
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import os
import platform
import socket
import struct
import tempfile
import time
from collections.abc import AsyncIterator, Iterator
from contextlib import asynccontextmanager, contextmanager, suppress
from multiprocessing.connection import Connection
from pathlib import Path

import numpy as np
import uvloop

from pcmrs.gateway.streams import pose_message, unity_message
from pcmrs.messages import BodyPose
from pcmrs.spatial import Transform
from pcmrs.testing.cell import RunningCell, open_cell
from pcmrs.testing.daemon import free_port
from pcmrs.testing.driving import accept, landmarks, tool_pose
from pcmrs.workflows.data import as_transform

PAPER_HZ = 60.0
SETTINGS = (
    "cell.rate=1", "procedure.max_pose_age=0.5", "robot.deadman=0.5", "procedure.motion.linear_velocity=0.25",
    "sim.digitization.reach_time=0.1",
)  # fmt: skip
SO_TIMESTAMPNS = 35
PREFIXES = {"slicer": "__msg_pose_", "unity": "crnt_", "bare": "bare"}

Arrivals = list[tuple[float, str]]
"""Time of arrival of each datagram, s of the monotonic clock, and its text."""


def receive(port: int, prefix: str, found: Connection) -> None:
    """Collect datagrams until they are requested; it runs in a separate process.

    Args:
        port: Port to listen at.
        prefix: Prefix of the datagrams that count.
        found: Connection for the result.
    """
    ahead = time.time() - time.monotonic()
    arrivals: Arrivals = []
    with socket.socket(type=socket.SOCK_DGRAM) as link:
        link.setsockopt(socket.SOL_SOCKET, SO_TIMESTAMPNS, 1)
        link.bind(("127.0.0.1", port))
        link.settimeout(0.1)
        found.send("ready")
        while not found.poll():
            with suppress(TimeoutError):
                data, ancillary, _, _ = link.recvmsg(512, 64)
                seconds, nanoseconds = struct.unpack("qq", ancillary[0][2])
                text = data.decode()
                if text.startswith(prefix):
                    arrivals.append((seconds + nanoseconds * 1e-9 - ahead, text))
    found.send(arrivals)


def send_bare(port: int, rate: float) -> None:
    """Send by the simplest timer until killed; it runs in a separate process.

    Args:
        port: Port of the receiver.
        rate: Datagrams per second.
    """
    with socket.socket(type=socket.SOCK_DGRAM) as link:
        due = time.monotonic()
        while True:
            link.sendto(b"bare" + b"0" * 70, ("127.0.0.1", port))
            due += 1.0 / rate
            time.sleep(max(0.0, due - time.monotonic()))


class Clients:
    """Receiving clients of one run."""

    def __init__(self) -> None:
        self._found: dict[str, Connection] = {}
        self.ports = {name: free_port() for name in PREFIXES}

    @contextmanager
    def listening(self) -> Iterator[None]:
        """Run the clients for the length of the context."""
        started = []
        for name, prefix in PREFIXES.items():
            self._found[name], there = multiprocessing.Pipe()
            process = multiprocessing.Process(target=receive, args=(self.ports[name], prefix, there), daemon=True)
            process.start()
            started.append(process)
            self._found[name].recv()
        try:
            yield
        finally:
            for process in started:
                process.kill()

    def arrivals(self) -> dict[str, Arrivals]:
        """Return the arrivals of all clients."""
        for found in self._found.values():
            found.send("end")
        return {name: found.recv() for name, found in self._found.items()}


class Exposures:
    """Exposure time of each pose message.

    Args:
        body_ref_from_image: Registration.
        tool_marker_from_tool_tip: Contact point of the tool in its marker body.
    """

    def __init__(self, body_ref_from_image: Transform, tool_marker_from_tool_tip: Transform) -> None:
        self._body_ref_from_image = body_ref_from_image
        self._tool_marker_from_tool_tip = tool_marker_from_tool_tip
        self._seen: dict[int, dict[str, BodyPose]] = {}
        self.captured: dict[str, float] = {}

    def take(self, pose: BodyPose) -> None:
        """Record a pose of the tracker."""
        if not pose.valid or pose.body not in ("coil", "body_ref"):
            return
        frame = self._seen.setdefault(pose.frame_number, {})
        frame[pose.body] = pose
        if len(frame) == 2:
            tracker_from_image = as_transform(frame["body_ref"]) @ self._body_ref_from_image
            tracker_from_tool_tip = as_transform(frame["coil"]) @ self._tool_marker_from_tool_tip
            image_from_tool_tip = tracker_from_image.inverse() @ tracker_from_tool_tip
            for text in (pose_message(image_from_tool_tip), unity_message("crnt_", image_from_tool_tip)):
                self.captured[text] = frame["coil"].captured
            del self._seen[pose.frame_number]


@asynccontextmanager
async def registered_cell(
    folder: Path, rate: float, tracker_hz: float, ports: dict[str, int]
) -> AsyncIterator[RunningCell]:
    """Start a cell with a registered head, a planned pose, and running streams.

    Args:
        folder: Parent of its folder.
        rate: Rate of the streams, Hz.
        tracker_hz: Rate of the tracker, Hz.
        ports: Ports of the clients by name.
    """
    links = (
        f"gateway.visualization={{port=0,stream_port={ports['slicer']}}}",
        f"gateway.mixed_reality={{stream_port={ports['unity']}}}",
        f"gateway.stream_rate_hz={rate}",
        f"sim.tracker.rate_hz={tracker_hz}",
    )
    async with open_cell(folder / f"at{rate:g}", (*SETTINGS, *links)) as cell:
        await accept(cell.client, "registration.plan_landmarks", **landmarks())
        await accept(cell.client, "digitization.digitize_all")
        await accept(cell.client, "registration.register")
        await accept(cell.client, "toolplan.plan", **tool_pose())
        await accept(cell.client, "robot.connect")
        await cell.client.until(lambda shown: not shown.running)
        with socket.socket(type=socket.SOCK_DGRAM) as link:
            link.sendto(b"start_visualizex;", cell.ready.links["visualization"])
        yield cell


async def place_until(cell: RunningCell, end: float) -> None:
    """Place and withdraw the tool until a time of the machine.

    Args:
        cell: Cell.
        end: Time, s.
    """
    while time.monotonic() < end:
        for operation in ("placement.approach", "placement.confirm", "placement.back_off", "placement.home"):
            await accept(cell.client, operation)


async def measure(rate: float, seconds: float, tracker_hz: float) -> dict[str, dict[str, float]]:
    """Return the statistics of the streams at one rate.

    Args:
        rate: Rate of the streams, Hz.
        seconds: Duration, s.
        tracker_hz: Rate of the tracker, Hz.
    """
    clients = Clients()
    bare = multiprocessing.Process(target=send_bare, args=(clients.ports["bare"], rate), daemon=True)
    with tempfile.TemporaryDirectory(prefix="pcmrs-") as name, clients.listening():
        async with registered_cell(Path(name), rate, tracker_hz, clients.ports) as cell:
            registered = (await cell.client.gathered()).body_ref_from_image
            assert registered is not None
            tip = as_transform((await cell.client.setup()).tool_marker_from_tool_tip)
            exposures = Exposures(as_transform(registered), tip)
            cell.client.listen("state/pose/*", BodyPose, exposures.take)
            bare.start()
            started = time.monotonic()
            await place_until(cell, started + seconds)
            arrivals, ended = clients.arrivals(), time.monotonic()
            bare.kill()
    return {
        name: figures([row for row in rows if started < row[0] < ended], rate, exposures.captured)
        for name, rows in arrivals.items()
    }


def figures(arrivals: Arrivals, rate: float, captured: dict[str, float]) -> dict[str, float]:
    """Return the statistics of one stream.

    Args:
        arrivals: Arrivals of its datagrams.
        rate: Requested rate, Hz.
        captured: Exposure times by text, s.
    """
    at = np.array([time for time, _ in arrivals])
    jitter = np.abs(np.diff(at) - 1.0 / rate) * 1e3
    found = {
        "rate_hz": (len(at) - 1) / (at[-1] - at[0]),
        "jitter_p50_ms": float(np.percentile(jitter, 50)),
        "jitter_p99_ms": float(np.percentile(jitter, 99)),
    }
    ages = [(time - captured[text]) * 1e3 for time, text in arrivals if text in captured]
    if ages:
        found |= {"age_p50_ms": float(np.percentile(ages, 50)), "age_p99_ms": float(np.percentile(ages, 99))}
        found["known"] = len(ages) / len(at)
    return found


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--rates", type=float, nargs="+", default=[60.0, 100.0, 250.0, 500.0])
    parser.add_argument("--seconds", type=float, default=15.0)
    parser.add_argument("--tracker-hz", type=float, default=60.0)
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    report = {f"{rate:g}": uvloop.run(measure(rate, options.seconds, options.tracker_hz)) for rate in options.rates}
    if options.json:
        print(json.dumps(report))
        return
    print(f"{os.cpu_count()} cores, Python {platform.python_version()}; the paper streams at {PAPER_HZ:g} Hz")
    for rate, clients in report.items():
        for name, values in clients.items():
            shown = "  ".join(f"{what} {value:8.2f}" for what, value in values.items())
            print(f"asked {rate:>4} Hz  {name:<7} {values['rate_hz'] / PAPER_HZ:5.2f} x the paper's  {shown}")


if __name__ == "__main__":
    main()
