"""Times at the devices: servo jitter, Stop at the node, age of poses, OpenIGTLink, EMG, and bare counterparts.

- `servo`: intervals between the set points of the KST driver at 200 Hz, by their arrival over TCP at a peer in a
  separate process, which answers like a cabinet; compared with a bare asyncio timer and a thread's `time.sleep` that
  send as many lines to the same peer. The three take turns.
- `turn`: processor time for which the KST driver occupies the loop of its node, which has the deadman, too: for
  each set point, each reading, and each hold.
- `stop`: from the arrival of a Stop at the node (`DeviceNode.stop`) to the arrival of the first braking set point at
  that peer; compared with half of a bare round trip over TCP. The limit is 20 ms.
- `tracker`: age of the coil's newest pose in the daemon's `PoseFeed`, when it arrives and at any moment, with device
  nodes as the daemon starts them, over the bus; of the simulated tracker, and of the driver `ndi` on a virtual one. A
  frame is published 30 ms after its exposure, 60 times a second. The transmission to the driver `ndi` takes additional
  time that no host can measure, so those ages are too small by that time.
- `openigtlink`: from a message's stamp to its arrival at `pyigtl`'s client, 100 times a second, from our link and from
  `pyigtl`'s server.
- `emg`: from the last sample of an epoch to the epoch, streamed in blocks of 10 ms; compared with a bare `pylsl`
  inlet that is polled every millisecond until it has that sample.

All processes share the machine's processors, and everything is simulated.

    .venv/bin/python benchmarks/devices.py [servo turn stop tracker openigtlink emg] [--seconds 10] [--json]
"""

from __future__ import annotations

import argparse
import asyncio
import json
import multiprocessing
import os
import platform
import socket
import tempfile
import time
from collections.abc import AsyncIterator, Callable
from contextlib import AsyncExitStack, asynccontextmanager, suppress
from pathlib import Path
from typing import Any
from uuid import uuid4

import numpy as np
import numpy.typing as npt
import structlog
import uvloop

from pcmrs.clock import SystemClock
from pcmrs.devices.drivers import kst, lsl
from pcmrs.devices.kst import drive
from pcmrs.devices.kst.connection import KstConnection
from pcmrs.devices.motion.follower import Follower
from pcmrs.devices.node import DeviceNode
from pcmrs.kinematics.arms import ARMS
from pcmrs.messages import BodyPose, JointTrajectory
from pcmrs.testing.daemon import free_port

Floats = npt.NDArray[np.float64]
Report = dict[str, dict[str, float]]

HOME = np.array(ARMS["iiwa14"].home)
PERIOD = 0.005
STOP_LIMIT_MS = 20.0
SET_POINTS = (b"jf_", b"jpJP_", b"jpExT_")


class Peer:
    """Cabinet whose arm is at once where it is commanded, and that records when each set point arrives."""

    def __init__(self, connection: socket.socket) -> None:
        self._socket = connection
        self._joints = "_".join(map(str, HOME))
        self.arrivals: list[float] = []

    def serve(self) -> None:
        """Answer the connection until it ends."""
        self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        unfinished = b""
        while data := self._socket.recv(1 << 16):
            now = time.monotonic()
            *lines, unfinished = (unfinished + data).split(b"\n")
            for line in lines:
                if line.startswith(SET_POINTS):
                    self.arrivals.append(now)
                if answer := self._answer(line):
                    self._socket.sendall(answer)

    def _answer(self, line: bytes) -> bytes:
        name, _, numbers = line.partition(b"_")
        if line.startswith(SET_POINTS):
            self._joints = "_".join(numbers.decode().split("_")[:7])
        if name in (b"jpJP", b"getJointsPositions"):
            return f"{self._joints}_\n".encode()
        if name == b"jpExT" or line == b"Torques_ext_J":
            return b"0.0_" * 7 + b"\n"
        if name == b"echo":
            return b"done\n"
        return b"" if name in (b"jf", b"end") else b"done\n"


def serve_peers(pipe: Any) -> None:
    """Serve one connection after the other, and send the arrivals of each when it has ended."""
    with socket.create_server(("127.0.0.1", 0)) as listening:
        pipe.send(listening.getsockname()[1])
        while True:
            connection, _ = listening.accept()
            peer = Peer(connection)
            with suppress(ConnectionError):
                peer.serve()
            connection.close()
            pipe.send(peer.arrivals)


class PeerProcess:
    """Process that serves peers."""

    def __init__(self) -> None:
        context = multiprocessing.get_context("spawn")
        self._pipe, there = context.Pipe()
        self._process = context.Process(target=serve_peers, args=(there,), daemon=True)
        self._process.start()
        self.port: int = self._pipe.recv()

    def arrivals(self) -> Floats:
        """Return the times of arrival of the last connection, s."""
        return np.array(self._pipe.recv())

    def close(self) -> None:
        """End the process."""
        self._process.terminate()
        self._process.join()


def smooth(start: Floats, goal: Floats, duration: float) -> JointTrajectory:
    """Return a minimum-jerk motion that starts and ends at rest.

    Args:
        start: Joint positions at the start, rad.
        goal: Joint positions at the end, rad.
        duration: Duration, s.
    """
    at = np.linspace(0.0, 1.0, 1 + round(duration / PERIOD))
    share = 10 * at**3 - 15 * at**4 + 6 * at**5
    return JointTrajectory(period=PERIOD, positions=(start + share[:, None] * (goal - start)).tolist())


@asynccontextmanager
async def connected(port: int) -> AsyncIterator[Any]:
    """Connect the driver to the peer at a port."""
    async with kst.open_devices(("robot",), {"kst": {"port": port}}, SystemClock()) as devices:
        await devices["robot"].connect()
        yield devices["robot"]


async def stream_by_driver(port: int, seconds: float) -> None:
    """Stream set points by the driver.

    Args:
        port: Port of the peer.
        seconds: Duration, s.
    """
    async with connected(port) as robot:
        await robot.follow(smooth(HOME, HOME + 0.2, seconds))


async def stream_by_asyncio(port: int, seconds: float) -> None:
    """Stream lines by a bare asyncio timer.

    Args:
        port: Port of the peer.
        seconds: Duration, s.
    """
    _, writer = await asyncio.open_connection("127.0.0.1", port)
    due = time.monotonic()
    for _ in range(round(seconds / PERIOD)):
        writer.write(b"jf_0_0_0_0_0_0_0_\n")
        due += PERIOD
        await asyncio.sleep(due - time.monotonic())
    writer.close()


def stream_by_thread(port: int, seconds: float) -> None:
    """Stream lines by a thread's `time.sleep`.

    Args:
        port: Port of the peer.
        seconds: Duration, s.
    """
    with socket.create_connection(("127.0.0.1", port)) as connection:
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        due = time.monotonic()
        for _ in range(round(seconds / PERIOD)):
            connection.sendall(b"jf_0_0_0_0_0_0_0_\n")
            due += PERIOD
            time.sleep(max(0.0, due - time.monotonic()))


def measure_servo(seconds: float) -> Report:
    """Return the intervals between set points."""
    peer, turn = PeerProcess(), 2.0
    streams: dict[str, Callable[[], Any]] = {
        "set points of the driver": lambda: run(stream_by_driver(peer.port, turn)),
        "bare asyncio timer": lambda: run(stream_by_asyncio(peer.port, turn)),
        "bare thread timer": lambda: stream_by_thread(peer.port, turn),
    }
    found: dict[str, list[Floats]] = {name: [] for name in streams}
    for _ in range(max(1, round(seconds / turn))):
        for name, stream in streams.items():
            stream()
            found[name].append(np.diff(peer.arrivals()))
    peer.close()
    return {name: summary(np.concatenate(each)) for name, each in found.items()}


def measure_turn(seconds: float) -> Report:
    """Return the processor times for which the driver's computations occupy the loop of its node."""
    times: dict[str, list[float]] = {}
    for owner, method, name in (
        (drive.Drive, "_send", "set point"),
        (drive.Drive, "_take_joints", "joints that were read"),
        (drive.MeasuredArm, "take_torques", "torques that were read, and force"),  # type: ignore[attr-defined]
        (Follower, "hold", "hold: brake of all joints"),
        (Follower, "follow", "start of a motion of 2 s, or longer"),
    ):
        times[name] = []
        setattr(owner, method, timing(getattr(owner, method), times[name]))
    peer = PeerProcess()
    run(stream_by_driver(peer.port, seconds))
    run(stop_often(peer.port, max(1, round(seconds))))
    peer.close()
    times["bare call"] = []
    empty = timing(lambda: None, times["bare call"])
    for _ in range(1000):
        empty()
    return {name: summary(np.array(each)) for name, each in times.items()}


def timing(original: Any, times: list[float]) -> Any:
    """Return a function that records the processor time of each call.

    Args:
        original: Function.
        times: List of times, s.
    """

    def call(*arguments: Any, **options: Any) -> Any:
        started = time.thread_time()
        try:
            return original(*arguments, **options)
        finally:
            times.append(time.thread_time() - started)

    return call


class Silence:
    """Bus without listeners, for the device node."""

    def publish(self, _key: str, _message: Any) -> None: ...

    def subscribe(self, _key: str, _kind: Any, _take: Any) -> None: ...

    def listen(self, _key: str, _kind: Any, _take: Any) -> None: ...

    def serve(self, _key: str, _kind: Any, _answer: Any) -> None: ...


async def stop_often(port: int, stops: int) -> tuple[list[float], list[int]]:
    """Return the time of each Stop, s, and the number of set points that had been sent before.

    Args:
        port: Port of the peer.
        stops: Number of Stops.
    """
    sent: list[float] = []
    note_set_points(sent)
    stopped_at, before = [], []
    bus: Any = Silence()
    rng = np.random.default_rng(1)
    async with connected(port) as robot:
        node = DeviceNode(bus, {"robot": robot}, SystemClock())
        for number in range(stops):
            here = np.array((await robot.joints()).positions)
            going = asyncio.create_task(robot.follow(smooth(here, HOME + 0.3 * (1 - number % 2), 2.0)))
            await asyncio.sleep(0.4 + PERIOD * rng.random())
            before.append(len(sent))
            stopped_at.append(time.monotonic())
            node.stop("benchmark")
            await going
    return stopped_at, before


def note_set_points(sent: list[float]) -> None:
    """Record the times at which the cabinet's driver sends set points."""
    for name in ("stream", "stream_for_joints", "stream_for_torques"):
        setattr(KstConnection, name, recording(getattr(KstConnection, name), sent))


def recording(original: Any, sent: list[float]) -> Any:
    """Return a method that records the time of each call.

    Args:
        original: Method of the cabinet.
        sent: List of times, s.
    """

    def send(self: KstConnection, positions: Any) -> Any:
        sent.append(time.monotonic())
        return original(self, positions)

    return send


async def round_trips(port: int, count: int) -> list[float]:
    """Return the times of bare round trips, s.

    Args:
        port: Port of the peer.
        count: Number of round trips.
    """
    reader, writer = await asyncio.open_connection("127.0.0.1", port)
    found = []
    for _ in range(count):
        begin = time.monotonic()
        writer.write(b"echo\n")
        await reader.readline()
        found.append(time.monotonic() - begin)
        await asyncio.sleep(PERIOD)
    writer.close()
    return found


def measure_stop(seconds: float) -> Report:
    """Return the delays from Stop to the first braking set point."""
    peer = PeerProcess()
    stopped_at, before = run(stop_often(peer.port, max(10, round(4 * seconds))))
    delays = peer.arrivals()[before] - np.array(stopped_at)
    bare = np.array(run(round_trips(peer.port, 500))) / 2
    peer.close()
    return {"Stop to first braking set point": summary(delays), "half a bare round trip": summary(bare)}


async def tracker_ages(driver: str, seconds: float) -> tuple[Floats, Floats]:
    """Return the ages of poses on arrival, and at independent moments, s.

    Args:
        driver: Name of the tracker's driver.
        seconds: Duration, s.
    """
    from pcmrs.bus import Bus
    from pcmrs.bus.seal import Seal, new_key
    from pcmrs.devices.poses import PoseFeed
    from pcmrs.processes.starting import start_by_exec
    from pcmrs.service.processes.nodes import NodeProcesses
    from pcmrs.service.supervisor import Supervisor
    from pcmrs.settings import read_settings

    def ended(_devices: list[str]) -> bool:
        return False  # a node that has ended is not restarted, since it measures nothing

    ports = free_port(), free_port()
    with tempfile.TemporaryDirectory() as folder:
        own = [f"cell.folder={folder}", "cell.name=benchmark", f"cell.endpoint=tcp/127.0.0.1:{ports[0]}"]
        settings = read_settings(None, [*own, f"tracker.driver={driver}", f"ndi.device=127.0.0.1:{ports[1]}"])
        clock, arrived = SystemClock(), []
        feed = PoseFeed(clock, 0.25)

        def take(_key: str, pose: BodyPose) -> None:
            feed.update(pose)
            if pose.body == "coil" and pose.valid:
                arrived.append(clock.monotonic() - pose.captured)

        async with AsyncExitStack() as stack:
            key = new_key()
            bus = await Bus.open(settings.bus("router"), Seal(key))
            stack.push_async_callback(bus.close)
            bus.subscribe("state/pose/**", BodyPose, take)
            supervisor = Supervisor(clock)
            nodes = NodeProcesses(settings, key, ended, lambda event: print(event.text), clock, start_by_exec)
            stack.push_async_callback(nodes.stop)
            await stack.enter_async_context(supervisor)
            nodes.start(supervisor)
            await feed.collect(("coil",), 60, 60.0)
            arrived.clear()
            return await sampled_ages(feed, clock, seconds), np.array(arrived)


async def sampled_ages(feed: Any, clock: SystemClock, seconds: float) -> Floats:
    """Return the ages of the newest pose at random moments, s.

    Args:
        feed: Feed of poses.
        clock: Clock of the machine.
        seconds: Duration, s.
    """
    rng, found, end = np.random.default_rng(1), [], time.monotonic() + seconds
    while time.monotonic() < end:
        await asyncio.sleep(0.01 * rng.random())
        newest = feed.frames_after(-1, ("coil",))[-1]["coil"]
        found.append(clock.monotonic() - newest.captured)
    return np.array(found)


def measure_tracker(seconds: float) -> Report:
    """Return the ages of poses."""
    found = {}
    for driver, name in (("ndi", "virtual NDI"), ("sim", "simulated tracker")):
        looked, arrived = run(tracker_ages(driver, seconds))
        found[f"{name}, on arrival"] = summary(arrived)
        found[f"{name}, at any moment"] = summary(looked)
    return found


class Daemon:
    """Data source of the link: three bodies that are always seen, and nothing else."""

    def __init__(self) -> None:
        from pcmrs.spatial import Transform

        self._pose = Transform.from_rotvec([0.1, 0.2, 1.5], [0.3, 0.0, 0.1])

    def seen(self) -> dict[str, Any]:
        return dict.fromkeys(("coil", "pointer", "body_ref"), self._pose)

    def registration(self) -> Any:
        return self._pose

    def snapshot(self) -> Any:
        from pcmrs.messages import BlueprintTag, Snapshot

        tag = BlueprintTag(id="benchmark", version="1", hash="")
        return Snapshot(sequence=1, branches={}, flags={}, running=[], latched=False, blueprint=tag)

    def __getattr__(self, _name: str) -> Any:
        return lambda *_: None


async def ours_to_pyigtl(count: int) -> list[float]:
    """Return the delays of our link's messages at pyigtl's client, s."""
    from pcmrs.gateway.links import open_gateway
    from pcmrs.gateway.settings import GatewayConfig, LinkConfig, OpenIgtLinkConfig

    off = LinkConfig()
    config = GatewayConfig(
        planner=off,
        robot=off,
        visualization=off,
        mixed_reality=off,
        mep=off,
        tcp_port=None,
        openigtlink=OpenIgtLinkConfig(enabled=True, port=0, rate_hz=100.0),
    )
    core: Any = Daemon()
    with tempfile.TemporaryDirectory() as folder:
        async with open_gateway(core, config, SystemClock(), Path(folder)) as gateway:
            return await asyncio.to_thread(listen, *gateway.addresses["openigtlink"], count)


def listen(host: str, port: int, count: int) -> list[float]:
    """Return the delays of messages at pyigtl's client, s.

    Args:
        host: Host of the link.
        port: Port of the link.
        count: Number of messages.
    """
    import pyigtl

    client = pyigtl.OpenIGTLinkClient(host, port)
    try:
        return [delay_of(client) for _ in range(count)]
    finally:
        client.stop()


def delay_of(client: Any) -> float:
    """Return the delay of the next message, s."""
    message = client.wait_for_message("CoilToImage", 5)
    return time.time() - float(message.timestamp)


def pyigtl_to_pyigtl(count: int) -> list[float]:
    """Return the delays of messages from pyigtl's server to its client, s."""
    import pyigtl

    port = free_port()
    server, client = pyigtl.OpenIGTLinkServer(port=port), pyigtl.OpenIGTLinkClient("127.0.0.1", port)
    found = []
    while not server.is_connected():
        time.sleep(0.01)
    for _ in range(count):
        message = pyigtl.TransformMessage(np.eye(4), device_name="CoilToImage", timestamp=time.time())
        server.send_message(message, wait=False)
        found.append(delay_of(client))
        time.sleep(0.01)
    client.stop()
    server.stop()
    return found


def measure_openigtlink(seconds: float) -> Report:
    """Return the delays of OpenIGTLink messages."""
    count = max(100, round(100 * seconds))
    ours = np.array(run(ours_to_pyigtl(count)))
    return {"our link": summary(ours), "pyigtl's server": summary(np.array(pyigtl_to_pyigtl(count)))}


RATE, BLOCK = 5000, 0.010


class Amplifier:
    """Stream of zeros with time stamps, and a marker outlet."""

    def __init__(self, name: str) -> None:
        from pcmrs.devices.lsl.library import load_lsl
        from pcmrs.devices.lsl.markers import MarkerOutlet

        self.lsl = load_lsl()
        info = self.lsl.StreamInfo(name, "EMG", 1, RATE, self.lsl.cf_float32, name)
        self._outlet = self.lsl.StreamOutlet(info)
        self.markers = MarkerOutlet(f"{name}-markers")

    async def run(self) -> None:
        """Send blocks until cancelled."""
        sent = int(self.lsl.local_clock() * RATE)
        while True:
            await asyncio.sleep(BLOCK)
            due = int(self.lsl.local_clock() * RATE)
            self._outlet.push_chunk(np.zeros((due - sent, 1), np.float32), (due - 1) / RATE)
            sent = due


async def epoch_delays(count: int, after: float = 0.05) -> tuple[list[float], list[float]]:
    """Return the delays of epochs of the driver, and of a bare inlet, after their last sample, s.

    Args:
        count: Number of epochs.
        after: Length of an epoch after the pulse, s.
    """
    from pcmrs.devices.lsl.markers import PulseMarker
    from pcmrs.errors import DeviceError

    name = f"benchmark-{uuid4().hex}"
    amplifier = Amplifier(name)
    sending = asyncio.create_task(amplifier.run())
    clock = amplifier.lsl.local_clock
    ours: list[float] = []
    bare: list[float] = []
    settings = {"lsl": {"stream": name, "markers": f"{name}-markers"}}
    async with lsl.open_devices(("emg",), settings, SystemClock()) as devices:
        (info,) = await asyncio.to_thread(amplifier.lsl.resolve_byprop, "name", name, 1, 10.0)
        inlet = amplifier.lsl.StreamInlet(info)
        inlet.open_stream(timeout=5.0)
        number = 0
        while len(ours) < count:
            number += 1
            inlet.pull_chunk(max_samples=1 << 16)
            pulse = clock()
            amplifier.markers.push(PulseMarker(number, 50.0).text, pulse)
            waiting = asyncio.create_task(newest_sample(inlet, pulse + after, clock))
            try:
                await devices["emg"].epoch(number, 0.05, after)
            except DeviceError:  # the streams have not been found yet
                await waiting
                continue
            ours.append(clock() - pulse - after)
            bare.append(await waiting)
    sending.cancel()
    return ours, bare


async def newest_sample(inlet: Any, wanted: float, clock: Callable[[], float]) -> float:
    """Wait for a sample at a time or later, and return the delay, s.

    Args:
        inlet: Bare inlet.
        wanted: Time of the sample, s.
        clock: Clock of the streams.
    """
    while True:
        _, times = inlet.pull_chunk(max_samples=1 << 16)
        if times and times[-1] >= wanted:
            return clock() - wanted
        await asyncio.sleep(0.001)


def measure_emg(seconds: float) -> Report:
    """Return the delays of epochs."""
    ours, bare = run(epoch_delays(max(20, round(5 * seconds))))
    return {"epoch of the driver": summary(np.array(ours)), "bare inlet": summary(np.array(bare))}


def run(coroutine: Any) -> Any:
    """Run a coroutine in the kind of loop that device nodes and daemon use."""
    with asyncio.Runner(loop_factory=uvloop.new_event_loop) as runner:
        return runner.run(coroutine)


def summary(times: Floats) -> dict[str, float]:
    """Return number, quantiles and maximum of times, ms."""
    p50, p99 = np.percentile(times, (50, 99)) * 1e3
    return {"count": len(times), "p50_ms": float(p50), "p99_ms": float(p99), "max_ms": float(times.max() * 1e3)}


MEASUREMENTS: dict[str, tuple[str, Callable[[float], Report]]] = {
    "servo": ("intervals between set points at 200 Hz, by their arrival", measure_servo),
    "turn": ("processor time of the driver on the loop of its node", measure_turn),
    "stop": ("Stop at the node", measure_stop),
    "tracker": ("age of the newest pose at the dispatcher", measure_tracker),
    "openigtlink": ("from the stamp to pyigtl's client", measure_openigtlink),
    "emg": ("from the last sample due to the epoch", measure_emg),
}


def show(title: str, rows: Report) -> None:
    """Print one table.

    Args:
        title: Title of the table.
        rows: Statistics by row; the last one is the bare counterpart.
    """
    print(f"{title}\n  {'':34} {'count':>6} {'p50 ms':>8} {'p99 ms':>8} {'max ms':>8} {'p99, ratio':>11}")
    bare = list(rows.values())[-1]["p99_ms"]
    for name, row in rows.items():
        print(
            f"  {name:34} {row['count']:6.0f} {row['p50_ms']:8.3f} {row['p99_ms']:8.3f} {row['max_ms']:8.3f} "
            f"{row['p99_ms'] / bare:11.2f}"
        )


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", nargs="*", metavar="WHAT", help=f"one of {', '.join(MEASUREMENTS)}; all by default")
    parser.add_argument("--seconds", type=float, default=10.0, help="approximate duration of each, s")
    parser.add_argument("--json", action="store_true")
    arguments = parser.parse_args()
    if unknown := set(arguments.what) - set(MEASUREMENTS):
        parser.error(f"unknown measurement {', '.join(sorted(unknown))}; choose from {', '.join(MEASUREMENTS)}")
    structlog.configure(logger_factory=structlog.ReturnLoggerFactory())
    load = os.getloadavg()[0]
    machine = f"{platform.machine()}, {os.cpu_count()} cores, load {load:.1f}, Python {platform.python_version()}"
    results = {}
    if not arguments.json:
        print(machine)
    for name in arguments.what or MEASUREMENTS:
        title, measure = MEASUREMENTS[name]
        results[name] = measure(arguments.seconds)
        if not arguments.json:
            show(title, results[name])
    if "stop" in results:
        worst = results["stop"]["Stop to first braking set point"]["p99_ms"]
        results["stop"]["limit"] = {"p99_ms": STOP_LIMIT_MS, "kept": worst <= STOP_LIMIT_MS}
    if arguments.json:
        print(json.dumps({"machine": machine, "results": results}))


if __name__ == "__main__":
    main()
