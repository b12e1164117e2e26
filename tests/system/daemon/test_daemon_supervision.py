"""A daemon that is stopped or blocked, nodes that die: what moves is held, and nothing goes on by itself."""

from __future__ import annotations

import asyncio
import os
import signal
from collections.abc import Iterator
from pathlib import Path

import pytest

from pcmrs.client import Client
from pcmrs.journal import JournalReader, JournalRow
from pcmrs.testing.driving import accept, moving, register, showing, until
from tests.system.daemon.daemon_process import (
    PATIENCE,
    SLOW,
    START_TIME,
    ServeProcess,
    is_running,
    own_settings,
    running_daemon,
    stands_still,
    wait_until,
)

BLOCKER = """
import signal, time
signal.signal(signal.SIGUSR1, lambda *_: time.sleep(0.4))
"""
"""A process with this blocks its event loop for 0.4 s when it is told to."""


@pytest.fixture
def slow_daemon(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[ServeProcess]:
    (tmp_path / "sitecustomize.py").write_text(BLOCKER)
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    with running_daemon([*own_settings(tmp_path), *SLOW], tmp_path) as daemon:
        yield daemon
        assert "Traceback" not in daemon.log


def events(daemon: ServeProcess) -> list[JournalRow]:
    with JournalReader(Path(daemon.ready.journal)) as journal:
        return [stored.row for stored in journal.read(kind="device")]


def told(daemon: ServeProcess, code: str) -> bool:
    return any(row.operation == code for row in events(daemon))


async def held_until_acknowledged(client: Client) -> None:
    """The arm stands, nothing goes on by itself, and no motion begins before somebody has looked."""
    await until(client, lambda snapshot: snapshot.latched and not snapshot.running)
    assert await stands_still(client)
    branches = (await client.state()).branches
    refused = await client.call("placement.approach")
    assert refused.decision == "rejected"
    assert (await client.state()).branches == branches
    assert branches["placement"] in ("held", "unknown")


async def test_arm_of_a_suspended_daemon_is_held_and_stays_held(slow_daemon: ServeProcess) -> None:
    daemon = slow_daemon
    async with daemon.client() as client:
        await register(client)
        async with moving(client) as approach:
            daemon.process.send_signal(signal.SIGSTOP)
            held = await asyncio.to_thread(wait_until, lambda: "held_by_node" in daemon.log)
            daemon.process.send_signal(signal.SIGCONT)
            assert held
            assert (await approach).decision in ("failed", "unknown")
        await held_until_acknowledged(client)


async def test_daemon_blocked_during_a_motion_reports_it_and_holds(slow_daemon: ServeProcess) -> None:
    daemon = slow_daemon
    async with daemon.client() as client:
        await register(client)
        async with moving(client) as approach:
            daemon.process.send_signal(signal.SIGUSR1)
            assert (await approach).decision in ("failed", "unknown")
        await held_until_acknowledged(client)
    assert await asyncio.to_thread(wait_until, lambda: told(daemon, "loop_stalled"))
    stalls = (row.result for row in events(daemon) if row.operation == "loop_stalled" and row.result is not None)
    stall = next(result for result in stalls if result["danger"])
    assert stall["fields"]["stall"] > stall["fields"]["limit"]


async def test_dead_node_is_restarted_and_the_operator_reconnects(tmp_path: Path) -> None:
    with running_daemon(own_settings(tmp_path), tmp_path) as daemon:
        async with daemon.client() as client:
            await register(client)
            (node,) = daemon.children()
            os.kill(node, signal.SIGKILL)
            await until(client, showing(robot="0", placement="unknown"))
            lost = await client.call("robot.connect")
            assert (lost.decision, lost.state) == ("unknown", "0"), "its node is only being begun anew"
            assert await asyncio.to_thread(wait_until, lambda: told(daemon, "node_restarted"))
            assert (await client.state()).latched
            async with asyncio.timeout(START_TIME):
                while (await client.call("robot.connect")).decision != "accepted":  # noqa: ASYNC110
                    await asyncio.sleep(0.2)
            await accept(client, "robot.acknowledge")
            (successor,) = daemon.children()
            assert successor != node
        assert daemon.end() == 0
        assert not is_running(successor)
        assert "Traceback" not in daemon.log


async def test_without_its_heart_the_daemon_moves_nothing(tmp_path: Path) -> None:
    """With another one it continues."""
    with running_daemon([*own_settings(tmp_path), *SLOW], tmp_path) as daemon:
        async with daemon.client() as client:
            await register(client)
            heart = daemon.heart()
            async with moving(client) as approach:
                os.kill(heart, signal.SIGSTOP)
                verdict = await approach
            assert (verdict.decision, verdict.state) == ("failed", "held")
            assert await asyncio.to_thread(wait_until, lambda: told(daemon, "daemon_silent"))
            await held_until_acknowledged(client)
            await accept(client, "robot.acknowledge")
            assert (await client.call("placement.back_off")).decision == "failed", "nobody would stop it"
            os.kill(heart, signal.SIGKILL)
            assert await asyncio.to_thread(wait_until, lambda: told(daemon, "heart_restarted"))
            async with asyncio.timeout(PATIENCE):
                while (await client.call("placement.back_off")).decision != "accepted":  # noqa: ASYNC110
                    await asyncio.sleep(0.2)
        assert daemon.end() == 0
        assert "Traceback" not in daemon.log
