"""A console and a cell behind two NATs: the workflow runs; what is lost on the way holds the arm, and is not repeated.

Everything simulated runs in real time. Behind NATs it is nightly, since each takes most of a minute.
"""

from __future__ import annotations

import json
import signal
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager, ExitStack, contextmanager
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from pcmrs.client import PlainClient
from pcmrs.clock import SystemClock
from pcmrs.errors import AccessError
from pcmrs.messages import BodyPose, DeviceHealth, JointState, Snapshot
from pcmrs.pki import read_credentials
from pcmrs.testing.cell import LIGHT, QUICK
from pcmrs.testing.natlab import Side, missing
from tests.system.network.remote_cell import (
    CELL,
    PATIENCE,
    RATMS,
    SITE,
    Loopback,
    RemoteCell,
    behind_nats,
    long_way,
    remote_cell,
)

REAL_TIME = ("cell.rate=1",)
PATIENT = (
    *REAL_TIME, "procedure.teleoperation.deadman=0.5", "robot.deadman=1.0", "procedure.following.longest_gap=0.2",
    "sim.arm.physics=kinematic",
)  # fmt: skip
"""A busy machine may be late itself."""
needs_namespaces = pytest.mark.skipif(bool(missing()), reason=missing())
pytestmark = pytest.mark.timeout(400)


@contextmanager
def holding(cell: RemoteCell) -> Iterator[None]:
    """The console holds the cell."""
    holder = cell.begin("lease", "hold")
    assert holder.stdout is not None
    assert "held" in holder.stdout.readline(), holder.stderr and holder.stderr.read()
    try:
        yield
    finally:
        holder.send_signal(signal.SIGINT)
        holder.communicate(timeout=60.0)


def perform(cell: RemoteCell, upto: str = "placement.home") -> None:
    for name, arguments in RATMS:
        cell.accept(name, arguments)
        if name == "robot.connect":  # the daemon locates the arm, and no motion waits for that
            shown = cell.until(lambda shown: not shown["running"])
            if shown["branches"]["placement"] == "unknown":  # the tracker was late
                cell.accept("placement.locate")
        if name == upto:
            return


def back_off_on_site(cell: RemoteCell) -> None:
    for name in ("lease.acquire", "robot.acknowledge", "placement.back_off"):
        assert cell.call_on_site(name) == "accepted"


@needs_namespaces
@pytest.mark.nightly
def test_the_workflow_runs_from_behind_another_nat(tmp_path: Path) -> None:
    with behind_nats() as network, remote_cell(network, tmp_path) as cell:
        refused = cell.call("registration.reinit", {})
        assert refused["reason"]["code"] == "no_lease"
        with holding(cell):
            perform(cell)
        assert {row["user"] for row in cell.rows("approach")} == {"tom"}
        assert cell.on_site()["lease"] is None


def test_the_workflow_runs_through_a_router_on_loopback(tmp_path: Path) -> None:
    network = Loopback()
    with remote_cell(network, tmp_path, *QUICK, *PATIENT, *LIGHT, "procedure.max_pose_age=3") as cell:
        tom = read_credentials(tmp_path / "tom", SystemClock().wall())
        with PlainClient.connect(network.listen, SITE, CELL, credentials=tom) as client:
            check_that_devices_are_heard(client)
            check_that_a_viewer_is_refused(network.listen, tmp_path)
            with holding(cell):
                (first, arguments), *others = RATMS
                cell.accept(first, arguments)
                for name, arguments in others:
                    accept(client, name, arguments)


def accept(client: PlainClient, name: str, arguments: Mapping[str, Any]) -> None:
    """What `perform` does at the command line, on one connection: a new process for each command takes long."""
    verdict = client.call(name, arguments)
    assert verdict.decision == "accepted", verdict
    if name == "robot.connect":
        shown = client.until(lambda shown: not shown.running)
        if shown.branches["placement"] == "unknown":  # the tracker was late
            accept(client, "placement.locate", {})


def check_that_a_viewer_is_refused(endpoint: str, folder: Path) -> None:
    """The router drops a viewer's commands without an answer: the client says why, and waits for nothing."""
    eve = read_credentials(folder / "eve", SystemClock().wall())
    refused = pytest.raises(AccessError, match="eve is a viewer here, and sends no commands")
    with PlainClient.connect(endpoint, SITE, CELL, credentials=eve) as client, refused:
        client.call("robot.connect")


def check_that_devices_are_heard(client: PlainClient) -> None:
    """What devices tell on site goes through the router."""
    told: dict[str, type[Any]] = {
        "state/joints": JointState, "state/pose/*": BodyPose, "dev/*/state": DeviceHealth, "state/fsm": Snapshot,
    }  # fmt: skip
    heard = {key: threading.Event() for key in told}
    for key, kind in told.items():
        client.listen(key, kind, partial(lambda event, _: event.set(), heard[key]))
    for key, event in heard.items():
        assert event.wait(PATIENCE), key


@pytest.mark.nightly
@pytest.mark.parametrize("network", [Loopback, pytest.param(behind_nats, marks=needs_namespaces)])
def test_the_tool_is_guided_from_far_away(tmp_path: Path, network: Callable[[], Any]) -> None:
    with ExitStack() as stack:
        way = network()
        way = stack.enter_context(way) if isinstance(way, AbstractContextManager) else way
        dialled = stack.enter_context(long_way(way, delay=0.15, jitter=0.03))
        cell = stack.enter_context(remote_cell(way, tmp_path, *PATIENT, dialled=dialled))
        with holding(cell):
            perform(cell, upto="placement.approach")
            guiding = cell.guide("0.0 0 0 0.005 0 0 0\n2.0 0 0 0 0 0 0\n3.0 open\n3.5 open\n")
            said, complaint = guiding.communicate(timeout=120.0)
            assert guiding.returncode == 0, complaint
            cell.accept("placement.back_off")
            cell.accept("placement.home")
    told = [json.loads(line) for line in said.splitlines()]
    assert max(each["height"] for each in told) - told[0]["height"] > 0.001, "the tool has moved"
    slowed = [each for each in told if each["round_trip"] is not None]
    assert min(each["round_trip"] for each in slowed) >= 0.3
    assert all(each["scale"] < 1.0 for each in slowed)


@needs_namespaces
@pytest.mark.nightly
@pytest.mark.parametrize("side", ["remote", "cell"])
def test_a_side_is_cut_while_the_tool_is_guided(tmp_path: Path, side: Side) -> None:
    with behind_nats() as network, remote_cell(network, tmp_path, *REAL_TIME) as cell:
        with holding(cell):
            perform(cell, upto="placement.approach")
            guiding = cell.guide("0.0 0 0 0.002 0 0 0\n60.0 open\n")
            assert guiding.stdout is not None
            heights = (json.loads(line)["height"] for line in guiding.stdout)
            start = next(heights)
            assert any(height > start + 0.001 for height in heights), "the tool moves"
            network.lab.cut(side)
            held = cell.until(lambda shown: shown["latched"] and not shown["running"])
            assert (held["branches"]["placement"], held["branches"]["teleoperation"]) == ("held", "off")
            network.lab.restore(side)
            guiding.communicate(timeout=120.0)
            assert guiding.returncode != 0, "who guides is told"
            assert cell.pcmrs("state", "--json").returncode == 0, "the way is open again, and nothing was started anew"
            assert cell.on_site()["branches"]["placement"] == "held"
        assert len(cell.rows("teleoperator_lost")) == 1, "the deadman has held it, and nothing else"
        assert len([row for row in cell.rows("guide") if row["kind"] == "intent"]) == 1
        back_off_on_site(cell)


@needs_namespaces
@pytest.mark.nightly
def test_packets_are_lost(tmp_path: Path) -> None:
    with behind_nats() as network, remote_cell(network, tmp_path, "access.lease_s=15") as cell:
        for side in ("cell", "remote"):
            network.lab.lose(side, 0.2)
        with holding(cell):
            perform(cell)
        assert len([row for row in cell.rows("approach") if row["kind"] == "intent"]) == 1


@needs_namespaces
@pytest.mark.nightly
@pytest.mark.parametrize("side", ["remote", "cell"])
def test_a_side_is_cut_in_motion(tmp_path: Path, side: Side) -> None:
    with behind_nats() as network, remote_cell(network, tmp_path, *REAL_TIME) as cell:
        with holding(cell):
            perform(cell, upto="robot.connect")
            moving = cell.begin("call", "placement.approach", "--json")
            cell.until(lambda shown: any(each["operation"] == "approach" for each in shown["running"]))
            network.lab.cut(side)
            held = cell.until(lambda shown: shown["latched"] and not shown["running"])
            assert held["branches"]["placement"] == "held"
            assert held["lease"] is None
            network.lab.restore(side)
            moving.communicate(timeout=60.0)
            time.sleep(2.0)  # nothing is to happen in it
            assert cell.on_site()["branches"]["placement"] == "held"
        assert len([row for row in cell.rows("approach") if row["kind"] == "intent"]) == 1
        back_off_on_site(cell)


@needs_namespaces
@pytest.mark.nightly
def test_the_router_is_killed_and_started_again(tmp_path: Path) -> None:
    with behind_nats() as network, remote_cell(network, tmp_path) as cell:
        watching = cell.begin("watch", "--json")
        assert watching.stdout is not None
        assert watching.stdout.readline()
        with holding(cell):
            perform(cell, upto="registration.plan_landmarks")
        cell.restart_router()
        with holding(cell):
            perform(cell)
        watching.terminate()
        heard, _ = watching.communicate(timeout=60.0)
        assert '"operation":"home"' in heard, "who watches hears on, without being started again"
