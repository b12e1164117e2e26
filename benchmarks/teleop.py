"""Teleoperation through a router: the latency from a set point to the robot, and the capacity of one router.

`latency`: teleoperator, router, daemon and robot node, as processes of this machine over TLS on loopback, in one run
with bare Zenoh sessions on the same route. A teleoperator at rest commands a motion; `robot` is the time until the
first set point that moves a joint passes on the key of the robot's node, `bare` that of a message of the same length
from another teleoperator's Zenoh session, through the same router and the daemon's, to a session on site. `robot`
includes the wait for the next step of the daemon's loop, up to 10 ms.

`curve`: minimal cells, each a process that publishes joints at 1 kHz and answers commands, and viewers who subscribe to
all of them, on one router; in addition a command every 20 ms to the first cell. It ends when the p99 of these commands
has doubled, or no cell answers any more. Router, cells, viewers and commanding client share this machine's processors;
the column `router` is the router's share of one processor.

    .venv/bin/python benchmarks/teleop.py [latency curve] [--samples 200] [--seconds 6] [--plot teleop.png] [--json]
"""

from __future__ import annotations

import argparse
import asyncio
import json
import multiprocessing
import os
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import AsyncIterator, Iterator
from contextlib import AsyncExitStack, asynccontextmanager, contextmanager
from dataclasses import asdict, dataclass
from multiprocessing.synchronize import Event
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
import zenoh

from pcmrs.bus import Bus, BusSettings, Credentials
from pcmrs.bus.codec import pack, unpack
from pcmrs.bus.commands import Envelope
from pcmrs.bus.settings import open_session
from pcmrs.client import Client
from pcmrs.errors import BusError, PcmrsError
from pcmrs.messages import JointSetpoint, JointState, TeleopSetpoint, TeleopStatus, Verdict
from pcmrs.messages.identity import PEOPLE, Role
from pcmrs.messages.teleop import Twist
from pcmrs.pki import Authority, read_credentials, read_register
from pcmrs.testing.cell import QUICK, REAL_TIME
from pcmrs.testing.daemon import free_port, own_settings, running_daemon
from pcmrs.testing.driving import accept, showing, to_standoff, until

SITE, CELL = "lab", "far1"
STEPS = [(1, 0), (1, 1), (2, 1), (2, 2), (4, 2), (4, 4), (8, 4), (8, 8)]
"""Numbers of cells and viewers."""
RATE = 1000.0
UP: Twist = (0.0, 0.0, 0.01, 0.0, 0.0, 0.0)
DOWN: Twist = (0.0, 0.0, -0.01, 0.0, 0.0, 0.0)
REST: Twist = (0.0,) * 6
PATIENT = (
    "procedure.teleoperation.deadman=0.5",
    "procedure.teleoperation.slow_delay=1",
    "procedure.teleoperation.longest_delay=2",
)
"""Long limits, since the load of the machine is not measured here."""
PATIENCE = 20.0


class Site:
    """Authority, and a router that serves its members."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.authority = Authority.init(folder / "pki", SITE, time.time())
        self.endpoint = f"tls/127.0.0.1:{free_port()}"
        self.issue("router", "gate", hosts=("127.0.0.1",))
        self.router: subprocess.Popen[bytes] | None = None

    @property
    def register(self) -> Path:
        return self.authority.folder / "register.json"

    def issue(self, role: Role, name: str, hosts: tuple[str, ...] = ()) -> None:
        """Issue a certificate.

        Args:
            role: Role of the member.
            name: Name of the member.
            hosts: Host names in the certificate.
        """
        via = ("gate",) if role in PEOPLE else ()
        self.authority.issue(role, name, time.time(), hosts=hosts, via=via, cells=("lab/*",), into=self.folder)

    def credentials(self, name: str) -> Credentials:
        """Return the credentials of a member."""
        return read_credentials(self.folder / name, time.time())

    def client(self, name: str, cell: str = CELL) -> BusSettings:
        """Return the bus settings of a member at the router.

        Args:
            name: Name of the member.
            cell: Name of the cell.
        """
        return BusSettings(endpoint=self.endpoint, site=SITE, cell=cell, credentials=self.credentials(name))

    @contextmanager
    def routing(self) -> Iterator[subprocess.Popen[bytes]]:
        """Run the router for the length of the context; issue all certificates before, since it reads them once."""
        words = ["router", "--identity", str(self.folder / "gate"), "--register", str(self.register), "--json"]
        command = [sys.executable, "-m", "pcmrs.cli", *words, "--listen", self.endpoint]
        with subprocess.Popen(command, stdout=subprocess.PIPE) as process:
            try:
                assert process.stdout is not None
                assert process.stdout.readline(), "the router did not start"
                yield process
            finally:
                process.terminate()


# -- latency ------------------------------------------------------------------------------------------------------


class Latency:
    """Commands motions and records when they arrive at the robot's node, and messages of bare Zenoh."""

    def __init__(self, teleoperator: Bus, bare: zenoh.Session, on_site: zenoh.Session, prefix: str) -> None:
        self._bus, self._loop = teleoperator, asyncio.get_running_loop()
        self._status: TeleopStatus | None = None
        self._sequence = 0
        self._moving, self._arrived = asyncio.Event(), asyncio.Event()
        self._moves = False
        self._moved_at = self._arrived_at = 0.0
        self._bare = bare.declare_publisher(f"{prefix}/teleop/bea", priority=zenoh.Priority.REAL_TIME, express=True)
        teleoperator.subscribe("state/teleop", TeleopStatus, self._take_status)
        self._subscribers = [
            on_site.declare_subscriber(f"{prefix}/dev/robot/setpoint", self._take_joints),
            on_site.declare_subscriber(f"{prefix}/teleop/bea", self._take_bare),
        ]

    async def sample(self, rest: float, twist: Twist) -> tuple[float, float]:
        """Return the latency to the robot and of bare Zenoh, s.

        Args:
            rest: Time for which the tool rests before, s.
            twist: Commanded twist.
        """
        end = time.monotonic() + rest
        while time.monotonic() < end or self._moves:
            self._send(REST)
            await asyncio.sleep(0.02)
        self._arrived.clear()
        sent = time.monotonic()
        self._bare.put(pack(self._setpoint(REST)))
        await asyncio.wait_for(self._arrived.wait(), PATIENCE)
        bare = self._arrived_at - sent
        self._moving.clear()
        sent = time.monotonic()
        while not self._moving.is_set():
            self._send(twist)
            await asyncio.wait([asyncio.ensure_future(self._moving.wait())], timeout=0.05)
        return self._moved_at - sent, bare

    def _setpoint(self, twist: Twist) -> TeleopSetpoint:
        assert self._status is not None
        self._sequence += 1
        return TeleopSetpoint(
            sequence=self._sequence, sent=time.monotonic(), seen=self._status.stamp, ttl=1.0, twist=twist
        )

    def _send(self, twist: Twist) -> None:
        if self._status is not None:
            self._bus.publish("teleop/tom", self._setpoint(twist))

    def _take_status(self, _key: str, status: TeleopStatus) -> None:
        self._status = status

    def _take_joints(self, sample: zenoh.Sample) -> None:
        now, setpoint = time.monotonic(), unpack(sample.payload.to_bytes(), JointSetpoint)
        moves = bool(np.any(setpoint.velocities))
        if moves and not self._moves:
            self._moved_at = now
            self._loop.call_soon_threadsafe(self._moving.set)
        self._moves = moves

    def _take_bare(self, _sample: zenoh.Sample) -> None:
        self._arrived_at = time.monotonic()
        self._loop.call_soon_threadsafe(self._arrived.set)


async def latency(samples: int) -> dict[str, float]:
    """Return the statistics of the latencies, ms."""
    with tempfile.TemporaryDirectory(prefix="pcmrs-") as name:
        site = Site(Path(name))
        site.issue("daemon", CELL)
        for teleoperator in ("tom", "bea"):
            site.issue("teleoperator", teleoperator)
        with site.routing():
            async with _guided_cell(site) as measuring:
                generator = np.random.default_rng(1)
                found = np.array(
                    [await measuring.sample(0.2 + 0.05 * generator.random(), (UP, DOWN)[n % 2]) for n in range(samples)]
                )
    robot, bare = found.T * 1000.0
    report = {
        f"{what}_p{p}_ms": float(np.percentile(v, p))
        for what, v in (("robot", robot), ("bare", bare))
        for p in (50, 99)
    }
    return report | {f"ratio_p{p}": report[f"robot_p{p}_ms"] / report[f"bare_p{p}_ms"] for p in (50, 99)}


@asynccontextmanager
async def _guided_cell(site: Site) -> AsyncIterator[Latency]:
    """Start a daemon behind the router, whose tool is guided by tom with the clutch engaged."""
    access = (
        f"access.identity={site.folder / CELL}",
        f"access.register={site.register}",
        f'access.routers=["{site.endpoint}"]',
    )
    settings = [*own_settings(site.folder / "cell", CELL), *QUICK, *REAL_TIME, *PATIENT, *access]
    async with AsyncExitStack() as stack:
        daemon = await stack.enter_async_context(running_daemon(settings, site.folder / "log"))
        tom = await _reached(site, stack)
        await stack.enter_async_context(tom.holding())
        await to_standoff(tom)
        bus = await Bus.open(site.client("tom"))
        stack.push_async_callback(bus.close)
        bare, on_site = open_session(site.client("bea")), open_session(BusSettings(endpoint=daemon.ready.endpoint))
        stack.callback(_close, bare)
        stack.callback(_close, on_site)
        measuring = Latency(bus, bare, on_site, daemon.ready.prefix)
        await accept(tom, "placement.guide")
        await accept(tom, "teleoperation.engage")
        await until(tom, showing(teleoperation="engaged"))
        yield measuring


async def _reached(site: Site, stack: AsyncExitStack) -> Client:
    """Return a client of the daemon as soon as both are connected to the router."""
    end, credentials = time.monotonic() + PATIENCE, site.credentials("tom")
    while True:
        try:
            return await stack.enter_async_context(Client.connect(site.endpoint, SITE, CELL, credentials=credentials))
        except BusError:
            if time.monotonic() > end:
                raise
            await asyncio.sleep(0.2)


def _close(session: Any) -> None:
    session.close()


# -- curve --------------------------------------------------------------------------------------------------------


@dataclass
class Step:
    """Results with a number of cells and viewers.

    Attributes:
        delivered: Messages that the viewers received, per second.
        router: Share of one processor that the router used.
    """

    cells: int
    viewers: int
    p50_ms: float
    p99_ms: float
    delivered: float
    router: float


def run_minimal_cell(settings: BusSettings, ended: Event) -> None:
    """Run a cell that publishes its joints and accepts every command.

    Args:
        settings: Settings of its bus.
        ended: Set when it must end.
    """

    async def answer(_key: str, _envelope: Envelope) -> Verdict:
        return Verdict(id="", branch="robot", operation="connect", decision="accepted", state="1", sequence=0)

    async def run() -> None:
        bus = await Bus.open(settings)
        bus.serve("cmd/*/*/*", Envelope, answer)
        publishing = threading.Thread(target=_publish, args=(bus, ended))
        publishing.start()
        await asyncio.get_running_loop().run_in_executor(None, ended.wait)
        publishing.join()
        await bus.close()

    asyncio.run(run())


def _publish(bus: Bus, ended: Event) -> None:
    start, number = time.monotonic(), 0
    while not ended.is_set():
        number += 1
        time.sleep(max(0.0, start + number / RATE - time.monotonic()))
        now = time.monotonic()
        state = JointState(captured=now, sent=now, positions=[0.1] * 7, velocities=[0.1] * 7, torques=[0.1] * 7)
        bus.publish("state/joints", state)


def run_viewer(settings: list[BusSettings], ended: Event, received: Any) -> None:
    """Run a viewer who watches all cells.

    Args:
        settings: Settings of the bus, one for each cell.
        ended: Set when it must end.
        received: Counter of received messages.
    """

    def take(_sample: zenoh.Sample) -> None:
        with received.get_lock():
            received.value += 1

    session = open_session(settings[0])
    subscribers: list[Any] = [
        session.declare_subscriber(f"pcmrs/{SITE}/{each.cell}/state/joints", take) for each in settings
    ]
    ended.wait()
    for subscriber in subscribers:
        subscriber.undeclare()
    _close(session)


async def curve(seconds: float) -> list[Step]:
    """Return the results for all numbers of cells and viewers."""
    most_cells, most_viewers = STEPS[-1]
    with tempfile.TemporaryDirectory(prefix="pcmrs-") as name:
        site = Site(Path(name))
        for number in range(most_cells):
            site.issue("daemon", f"cell{number}")
        for number in range(most_viewers):
            site.issue("viewer", f"viewer{number}")
        site.issue("operator", "anna")
        steps: list[Step] = []
        with site.routing() as router:
            for cells, viewers in STEPS:
                try:
                    steps.append(await _step(site, router.pid, cells, viewers, seconds))
                except TimeoutError as error:  # more processes than this machine can start in that time
                    print(f"{cells} cells, {viewers} viewers: {error}", file=sys.stderr)
                    break
                print(steps[-1], file=sys.stderr)
                if steps[-1].p99_ms > 2.0 * steps[0].p99_ms:
                    break
        return steps


async def _step(site: Site, router: int, cells: int, viewers: int, seconds: float) -> Step:
    context = multiprocessing.get_context("spawn")
    ended, received = context.Event(), context.Value("q", 0)
    members = tuple(read_register(site.register))
    processes = []
    for number in range(cells):
        own = BusSettings(
            mode="router",
            endpoint="",
            site=SITE,
            cell=f"cell{number}",
            credentials=site.credentials(f"cell{number}"),
            routers=(site.endpoint,),
            members=members,
        )
        processes.append(context.Process(target=run_minimal_cell, args=(own, ended)))
    for number in range(viewers):
        watched = [site.client(f"viewer{number}", f"cell{each}") for each in range(cells)]
        processes.append(context.Process(target=run_viewer, args=(watched, ended, received)))
    for process in processes:
        process.start()
    try:
        return await _measure_commands(site, router, (cells, viewers), received, seconds)
    finally:
        ended.set()
        for process in processes:
            process.join(PATIENCE)
            process.kill()


async def _measure_commands(site: Site, router: int, size: tuple[int, int], received: Any, seconds: float) -> Step:
    bus = await Bus.open(site.client("anna", "cell0"))
    try:
        await _wait_for_answer(bus)
        await asyncio.sleep(3.0)  # all cells and viewers have started
        before, busy, begun = received.value, _processor_time(router), time.monotonic()
        took: list[float] = []
        while time.monotonic() - begun < seconds:
            sent = time.monotonic()
            await bus.request("cmd/anna/robot/connect", Envelope(), Verdict, PATIENCE)
            took.append((time.monotonic() - sent) * 1000.0)
            await asyncio.sleep(0.02)
        passed = time.monotonic() - begun
        p50, p99 = np.percentile(took, (50, 99)).tolist()
        delivered, used = (received.value - before) / passed, (_processor_time(router) - busy) / passed
        return Step(*size, p50_ms=p50, p99_ms=p99, delivered=delivered, router=used)
    finally:
        await bus.close()


async def _wait_for_answer(bus: Bus) -> None:
    end = time.monotonic() + PATIENCE
    while time.monotonic() < end:
        try:
            await bus.request("cmd/anna/robot/connect", Envelope(), Verdict, 1.0)
        except PcmrsError:  # the cell has not started yet
            await asyncio.sleep(0.2)
        else:
            return
    raise TimeoutError(f"no cell answered within {PATIENCE:g} s")


def _processor_time(pid: int) -> float:
    """Return the processor time that a process has used so far, s."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def plot(steps: list[Step], file: Path) -> None:
    """Draw the curve.

    Args:
        steps: Results by numbers of cells and viewers.
        file: PNG file to write.
    """
    figure, axes = plt.subplots(figsize=(7.0, 4.0), layout="constrained")
    delivered = [each.delivered / 1000.0 for each in steps]
    axes.plot(delivered, [each.p99_ms for each in steps], "o-", label="p99")
    axes.plot(delivered, [each.p50_ms for each in steps], "s--", label="p50")
    axes.axhline(2.0 * steps[0].p99_ms, color="0.6", linestyle=":", label="twice the p99 without viewers")
    for each, x in zip(steps, delivered, strict=True):
        axes.annotate(f"{each.cells}×{each.viewers}", (x, each.p99_ms), xytext=(3, 4), textcoords="offset points")
    axes.set(
        xlabel="messages delivered, thousands per second (cells × viewers)", ylabel="command, ms", ylim=(0.0, None)
    )
    axes.legend()
    figure.savefig(file, dpi=150)


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", nargs="*", default=["latency", "curve"])
    parser.add_argument("--samples", type=int, default=200)
    parser.add_argument("--seconds", type=float, default=6.0, help="duration of each step of the curve")
    parser.add_argument("--plot", type=Path)
    parser.add_argument("--json", action="store_true")
    given = parser.parse_args()
    found: dict[str, Any] = {}
    if "latency" in given.what:
        found["latency"] = asyncio.run(latency(given.samples))
    if "curve" in given.what:
        steps = asyncio.run(curve(given.seconds))
        found["curve"] = [asdict(each) for each in steps]
        if given.plot is not None:
            plot(steps, given.plot)
    print(json.dumps(found) if given.json else _text(found))


def _text(found: dict[str, Any]) -> str:
    lines = [f"{name:14} {value:8.2f}" for name, value in found.get("latency", {}).items()]
    if "curve" in found:
        lines.append("cells viewers   p50 ms   p99 ms   delivered/s   router")
        lines += [
            f"{each['cells']:5} {each['viewers']:7} {each['p50_ms']:8.2f} {each['p99_ms']:8.2f}"
            f" {each['delivered']:13.0f} {each['router']:7.0%}"
            for each in found["curve"]
        ]
    return "\n".join(lines)


if __name__ == "__main__":
    main()
