"""A console and a cell behind two NATs: the workflow runs; what is lost on the way holds the arm, and is not repeated.

Everything simulated runs in real time. Marked nightly but for one, since each takes most of a minute.
"""

from __future__ import annotations

import signal
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from remote_cell import RATMS, Loopback, RemoteCell, behind_nats, remote_cell

from pcmrs.campaign.natlab import missing

REAL_TIME = ("cell.rate=1",)
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
        if name == upto:
            return


@needs_namespaces
def test_the_workflow_runs_from_behind_another_nat(tmp_path: Path) -> None:
    with behind_nats() as network, remote_cell(network, tmp_path) as cell:
        refused = cell.call("registration.reinit", {})
        assert refused["reason"]["code"] == "no_lease"
        with holding(cell):
            perform(cell)
        assert {row["user"] for row in cell.rows("approach")} == {"tom"}
        assert cell.on_site()["lease"] is None


def test_the_workflow_runs_through_a_router_on_loopback(tmp_path: Path) -> None:
    with remote_cell(Loopback(), tmp_path) as cell, holding(cell):
        perform(cell)


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
def test_a_side_is_cut_in_motion(tmp_path: Path, side: str) -> None:
    with behind_nats() as network, remote_cell(network, tmp_path, *REAL_TIME) as cell:
        with holding(cell):
            perform(cell, upto="robot.connect")
            moving = cell.begin("call", "placement.approach", "--json")
            cell.until(lambda shown: any(each["operation"] == "approach" for each in shown["running"]))
            network.lab.cut(side)  # type: ignore[arg-type]
            held = cell.until(lambda shown: shown["latched"] and not shown["running"])
            assert held["branches"]["placement"] == "held"
            assert held["lease"] is None
            network.lab.mend(side)  # type: ignore[arg-type]
            moving.communicate(timeout=60.0)
            time.sleep(2.0)  # nothing is to happen in it
            assert cell.on_site()["branches"]["placement"] == "held"
        assert len([row for row in cell.rows("approach") if row["kind"] == "intent"]) == 1
        assert cell.call_on_site("lease.acquire") == "accepted"
        assert cell.call_on_site("robot.acknowledge") == "accepted"
        assert cell.call_on_site("placement.back_off") == "accepted"


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
