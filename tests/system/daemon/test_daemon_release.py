"""Latches, hold epochs and releases between a daemon and its nodes: real processes, each restarted alone.

What does not depend on processes is shown in simulated time.
"""

from __future__ import annotations

import asyncio
import os
import shlex
import signal
import subprocess
import sys
from collections.abc import AsyncIterator, Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path

import pytest

from pcmrs.client import Client
from pcmrs.clock import SystemClock
from pcmrs.devices.remote import RemoteRobot, RemoteScene
from pcmrs.errors import DeviceError, UnknownOutcomeError
from pcmrs.messages import JointTrajectory
from pcmrs.testing.cell import LIGHT
from pcmrs.testing.daemon import SIMULATED_TOOL
from pcmrs.testing.driving import (
    accept,
    acknowledge,
    connect,
    landmarks,
    moving,
    register,
    showing,
    to_standoff,
    tool_pose,
    until,
)
from pcmrs.testing.simulated import CellInSimulatedTime
from pcmrs_sim.deterministic.cell import SimulatedCell
from tests.system.daemon.daemon_process import (
    PATIENCE,
    ServeProcess,
    as_words,
    own_settings,
    running_daemon,
    stands_still,
    start_over,
    wait_until,
)
from tests.unit.sim.deterministic.simulated_cells import in_cell

ARM = ("robot", "tracker", "pointer", "scene")


@contextmanager
def running_node(settings: Sequence[str], folder: Path) -> Iterator[subprocess.Popen[bytes]]:
    """A device node that no daemon has started: it outlives every one, as on another machine."""
    command = shlex.join([sys.executable, "-m", "pcmrs.cli", "node", "sim", *ARM, *as_words(settings)])
    (endpoint,) = (setting for setting in settings if setting.startswith("cell.endpoint=tcp/"))
    daemon = endpoint.removeprefix("cell.endpoint=tcp/").replace(":", "/")
    with (folder / "node.log").open("ab") as log:
        # A node ends where there is no daemon to connect to; only a look at the port costs nothing.
        looked = f"until (: </dev/tcp/{daemon}) 2>/dev/null; do sleep 0.05; done"
        until_there = ["bash", "-c", f"until {{ {looked}; {command}; }}; do sleep 0.1; done"]
        process = subprocess.Popen(until_there, stdout=log, stderr=log, start_new_session=True)
    try:
        yield process
    finally:
        signal_node(process, signal.SIGKILL)


def signal_node(process: subprocess.Popen[bytes], number: signal.Signals) -> None:
    """Sends a signal to a node that `running_node` has started, once."""
    if process.poll() is None:
        os.killpg(process.pid, number)
    if number == signal.SIGKILL:
        process.wait()


def node_of(daemon: ServeProcess, driver: bytes) -> int:
    """Id of the node that serves `driver`."""
    return next(pid for pid in daemon.children() if driver in Path(f"/proc/{pid}/cmdline").read_bytes())


async def test_silent_stimulator_stays_latched_and_allows_a_retreat(tmp_path: Path) -> None:
    settings = [*own_settings(tmp_path), *LIGHT, "stimulator.driver=trigger", "emg.driver=none", "cell.rate=1"]
    with running_daemon(settings, tmp_path) as daemon:
        async with daemon.client() as client:
            await register(client)
            await to_standoff(client)
            node = node_of(daemon, b"trigger")
            os.kill(node, signal.SIGSTOP)
            await client.stop()
            acknowledged = await acknowledge(client)
            assert acknowledged.decision == "accepted"
            assert acknowledged.result == {"still_latched": ["stimulator"]}
            await accept(client, "placement.back_off")
            assert not (await client.state()).latched
            os.kill(node, signal.SIGKILL)
            # Its successor starts latched, while the daemon is not: a Stop with a number of its own.
            before = (await client.state()).stop.number
            await until(client, lambda snapshot: snapshot.latched)
            assert (await client.state()).stop.number > before
            async with asyncio.timeout(PATIENCE):
                while (await acknowledge(client)).result is not None:  # noqa: ASYNC110
                    await asyncio.sleep(0.2)


def test_device_request_not_from_the_daemon_moves_nothing(tmp_path: Path) -> None:
    async def play(cell: SimulatedCell, client: CellInSimulatedTime) -> None:
        await retract(client)
        stranger = RemoteRobot(cell.network.endpoint("stranger"), client.clock)
        posture = (await stranger.joints()).positions
        away = [posture, [posture[0] + 0.1, *posture[1:]]]
        with pytest.raises((DeviceError, UnknownOutcomeError), match="Ask again"):
            await stranger.follow(JointTrajectory(period=1.0, positions=away))
        await client.clock.sleep(2.0)
        assert (await stranger.joints()).positions == posture
        assert not client.snapshot.latched

    in_cell(play, tmp_path)


async def retract(client: CellInSimulatedTime) -> None:
    """Connect the robot, register the head and plan a pose; the tool is away from the head then."""
    await client.accept("robot.connect")
    await client.accept("registration.plan_landmarks", **landmarks())
    await client.accept("digitization.digitize_all")
    await client.accept("registration.register")
    await client.accept("toolplan.plan", **tool_pose())
    await client.until(lambda shown: shown.branches["placement"] == "retracted" and not shown.running)


class Apart:
    """A daemon without arm and tracker, and the node that serves them; each can be killed and started again alone.

    Args:
        folder: Folder of the cell.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._node_settings = [*own_settings(folder), *LIGHT, "stimulator.driver=none", "emg.driver=none"]
        self._daemon_settings = [*self._node_settings, *(f"{device}.driver=none" for device in ARM), *SIMULATED_TOOL]
        self._running_node, self._running_daemon = ExitStack(), ExitStack()
        self.start_node()
        self.start_daemon()

    def start_node(self) -> None:
        self._running_node.close()
        self.node = self._running_node.enter_context(running_node(self._node_settings, self._folder))

    def start_daemon(self) -> None:
        self._running_daemon.close()
        self.daemon = self._running_daemon.enter_context(running_daemon(self._daemon_settings, self._folder))

    def restart(self) -> None:
        """Start both again, as on the first day: the arm has been released by no daemon."""
        self._running_daemon.close()
        self.start_node()
        self.start_daemon()

    def end(self) -> None:
        self._running_daemon.close()
        self._running_node.close()


@pytest.fixture(scope="module")
def started_apart(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Apart]:
    apart = Apart(tmp_path_factory.mktemp("apart"))
    yield apart
    apart.end()


@pytest.fixture
async def apart(started_apart: Apart) -> AsyncIterator[Apart]:
    await start_over(started_apart.daemon)
    yield started_apart
    assert started_apart.daemon.process.poll() is None
    assert "Traceback" not in started_apart.daemon.log


async def test_nothing_acts_before_first_connect_but_a_hand_digitizes(apart: Apart) -> None:
    apart.restart()
    async with apart.daemon.client() as client, apart.daemon.bus() as bus:
        robot = RemoteRobot(bus, SystemClock())
        await hold_soon(robot)
        await accept(client, "registration.plan_landmarks", **landmarks())
        await accept_soon(client, "digitization.digitize_all")
        assert (await client.state()).branches["robot"] == "0"
        with pytest.raises(DeviceError, match="latched"):
            await robot.follow(JointTrajectory(period=0.01, positions=[[0.0] * 7]))
        await accept(client, "robot.connect")
        await accept(client, "registration.register")
        await accept(client, "toolplan.plan", **tool_pose())
        await until(client, lambda shown: shown.branches["placement"] == "retracted" and not shown.running)
        await accept(client, "placement.approach")


async def hold_soon(robot: RemoteRobot) -> None:
    """Hold the robot as soon as its node, which may be starting, answers."""
    async with asyncio.timeout(PATIENCE):
        while True:
            with suppress(UnknownOutcomeError):
                await robot.hold()
                return
            await asyncio.sleep(0.1)


async def accept_soon(client: Client, name: str) -> None:
    """Call an operation until it is accepted, because the first poses may not have arrived yet."""
    async with asyncio.timeout(PATIENCE):
        while (await client.call(name)).decision != "accepted":  # noqa: ASYNC110
            await asyncio.sleep(0.1)


async def test_failed_motion_is_followed_by_a_retreat_without_any_stop(apart: Apart) -> None:
    async with apart.daemon.client() as client, apart.daemon.bus() as bus:
        scene = RemoteScene(bus, SystemClock())
        await to_standoff(client)
        before = (await client.state()).stop.number
        try:
            async with moving(client, "placement.confirm") as confirm:
                await scene.occlude("body_ref", True)
                verdict = await confirm
        finally:
            await scene.occlude("body_ref", False)
        assert (verdict.decision, verdict.state) == ("failed", "held")
        shown = await client.state()
        assert (shown.latched, shown.stop.number) == (False, before)
        await accept(client, "placement.back_off")


async def test_daemon_that_restarts_alone_holds_what_was_released(apart: Apart) -> None:
    async with apart.daemon.client() as client:
        await to_standoff(client)
    apart.daemon.end(signal.SIGKILL)
    apart.start_daemon()
    assert apart.node.poll() is None
    async with apart.daemon.client() as client:
        assert await stands_still(client)
        await register(client)
        if (await client.state()).latched:
            await accept(client, "robot.acknowledge")
        assert (await client.state()).branches["placement"] in ("held", "retracted")
        await accept(client, "placement.back_off")


async def test_arm_node_that_restarts_alone_is_latched_until_confirmed(apart: Apart) -> None:
    async with apart.daemon.client() as client:
        await to_standoff(client)
        signal_node(apart.node, signal.SIGKILL)
        await until(client, showing(robot="0", placement="unknown"))
        first = (await client.state()).stop.number
        apart.start_node()
        await connect(client)
        assert (await client.state()).latched
        await until(client, lambda snapshot: snapshot.branches["placement"] != "unknown")
        refused = await client.call("placement.home")
        assert refused.reason is not None
        assert refused.reason.code == "latched", "looking is allowed, moving is not"
        assert (await client.state()).stop.number >= first
        await accept(client, "robot.acknowledge")
        held = (await client.state()).branches["placement"] == "held"
        await accept(client, "placement.back_off" if held else "placement.home")


async def test_nobody_acknowledges_while_a_hold_does_not_answer(apart: Apart) -> None:
    async with apart.daemon.client() as client:
        await register(client)
        signal_node(apart.node, signal.SIGSTOP)
        try:
            number = (await client.stop()).number
            refused = await client.call("robot.acknowledge", {"stop": number})
            assert refused.reason is not None
            # On a slow machine the hold, which waits for 1 s, may have failed before: then the node is asked.
            was_pending = "hold_not_confirmed" not in apart.daemon.log
            assert refused.reason.code == "stop_pending" or not was_pending
            assert refused.decision != "accepted"
            assert not (await client.state()).stop.confirmed
            assert await asyncio.to_thread(wait_until, lambda: "hold_not_confirmed" in apart.daemon.log)
            failed = await client.call("robot.acknowledge", {"stop": (await client.state()).stop.number})
            assert failed.decision != "accepted", "an arm that says nothing is not released"
            assert (await client.state()).latched
        finally:
            signal_node(apart.node, signal.SIGCONT)
