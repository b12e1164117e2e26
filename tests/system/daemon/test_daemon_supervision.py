"""A daemon that is stopped or blocked, nodes that die: what moves is held, and nothing goes on by itself."""

from __future__ import annotations

import asyncio
import os
import signal
from collections.abc import AsyncIterator, Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest

from pcmrs.client import Client
from pcmrs.journal import JournalReader, JournalRow
from pcmrs.testing.cell import LIGHT
from pcmrs.testing.driving import accept, moving, showing, until
from tests.system.daemon.daemon_process import (
    PATIENCE,
    SLOW,
    START_TIME,
    ServeProcess,
    is_running,
    own_settings,
    register_again,
    running_daemon,
    stands_still,
    wait_until,
)

BLOCKER = """
import signal, time
signal.signal(signal.SIGUSR1, lambda *_: time.sleep(0.8))
"""
"""A process with this blocks its event loop for longer than its deadman when it receives SIGUSR1."""


@pytest.fixture(scope="module")
def slow_daemon(tmp_path_factory: pytest.TempPathFactory) -> Iterator[ServeProcess]:
    folder = tmp_path_factory.mktemp("cell")
    (folder / "sitecustomize.py").write_text(BLOCKER)
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("PYTHONPATH", str(folder))
        with running_daemon([*own_settings(folder), *SLOW, *LIGHT], folder) as daemon:
            yield daemon
            if daemon.process.poll() is None:
                children = [*daemon.children(), daemon.heart()]
                assert daemon.end() == 0
                assert not any(map(is_running, children))


@dataclass
class Supervised:
    """The shared daemon with a registered head, and the last row of its journal before the test."""

    daemon: ServeProcess
    last_row: int

    def events(self) -> list[JournalRow]:
        with JournalReader(Path(self.daemon.ready.journal)) as journal:
            return [stored.row for stored in journal.read(after=self.last_row, kind="device")]

    def told(self, code: str) -> bool:
        return any(row.operation == code for row in self.events())


@pytest.fixture
async def supervised(slow_daemon: ServeProcess) -> AsyncIterator[Supervised]:
    await register_again(slow_daemon)
    with JournalReader(Path(slow_daemon.ready.journal)) as journal:
        (last,) = journal.read(last=1)
    yield Supervised(slow_daemon, last.sequence)
    assert "Traceback" not in slow_daemon.log


async def held_until_acknowledged(client: Client) -> None:
    """The arm stands, nothing goes on by itself, and no motion begins before somebody has looked."""
    await until(client, lambda snapshot: snapshot.latched and not snapshot.running)
    assert await stands_still(client)
    branches = (await client.state()).branches
    refused = await client.call("placement.approach")
    assert refused.decision == "rejected"
    assert (await client.state()).branches == branches
    assert branches["placement"] in ("held", "unknown")


async def test_arm_of_a_suspended_daemon_is_held_and_stays_held(supervised: Supervised) -> None:
    daemon = supervised.daemon
    async with daemon.client() as client:
        async with moving(client) as approach:
            daemon.process.send_signal(signal.SIGSTOP)
            held = await asyncio.to_thread(wait_until, lambda: "held_by_node" in daemon.log)
            daemon.process.send_signal(signal.SIGCONT)
            assert held
            assert (await approach).decision in ("failed", "unknown")
        await held_until_acknowledged(client)


async def test_daemon_blocked_during_a_motion_reports_it_and_holds(supervised: Supervised) -> None:
    async with supervised.daemon.client() as client:
        async with moving(client) as approach:
            supervised.daemon.process.send_signal(signal.SIGUSR1)
            assert (await approach).decision in ("failed", "unknown")
        await held_until_acknowledged(client)
    assert await asyncio.to_thread(wait_until, lambda: supervised.told("loop_stalled"))
    assert supervised.told("daemon_silent")
    stalls = [row.result for row in supervised.events() if row.operation == "loop_stalled" and row.result is not None]
    assert all(stall["fields"]["stall"] > stall["fields"]["limit"] for stall in stalls)


async def test_dead_node_is_restarted_and_the_operator_reconnects(supervised: Supervised) -> None:
    daemon = supervised.daemon
    async with daemon.client() as client:
        (node,) = daemon.children()
        os.kill(node, signal.SIGKILL)
        await until(client, showing(robot="0", placement="unknown"))
        lost = await client.call("robot.connect")
        assert (lost.decision, lost.state) == ("unknown", "0"), "its node is only being begun anew"
        assert await asyncio.to_thread(wait_until, lambda: supervised.told("node_restarted"))
        assert (await client.state()).latched
        async with asyncio.timeout(START_TIME):
            while (await client.call("robot.connect")).decision != "accepted":  # noqa: ASYNC110
                await asyncio.sleep(0.2)
        await accept(client, "robot.acknowledge")
        (successor,) = daemon.children()
        assert successor != node


async def test_without_its_heart_the_daemon_moves_nothing(supervised: Supervised) -> None:
    """With another one it continues."""
    async with supervised.daemon.client() as client:
        heart = supervised.daemon.heart()
        async with moving(client) as approach:
            os.kill(heart, signal.SIGSTOP)
            verdict = await approach
        assert (verdict.decision, verdict.state) == ("failed", "held")
        assert await asyncio.to_thread(wait_until, lambda: supervised.told("daemon_silent"))
        await held_until_acknowledged(client)
        await accept(client, "robot.acknowledge")
        assert (await client.call("placement.back_off")).decision == "failed", "nobody would stop it"
        os.kill(heart, signal.SIGKILL)
        assert await asyncio.to_thread(wait_until, lambda: supervised.told("heart_restarted"))
        async with asyncio.timeout(PATIENCE):
            while (await client.call("placement.back_off")).decision != "accepted":  # noqa: ASYNC110
                await asyncio.sleep(0.2)


async def test_the_cell_works_on_without_its_fork_server(supervised: Supervised) -> None:
    """A motion continues, and a node that dies later is restarted.

    The last test: it ends the daemon, whose processes can no longer be found as children of their server.
    """
    daemon = supervised.daemon
    (node,), heart = daemon.children(), daemon.heart()
    async with daemon.client() as client:
        async with moving(client) as approach:
            os.kill(daemon.fork_server(), signal.SIGKILL)
            assert await asyncio.to_thread(wait_until, lambda: "fork_server_lost" in daemon.log)
            assert (await approach).decision == "accepted"
        os.kill(node, signal.SIGKILL)
        await until(client, showing(robot="0", placement="unknown"))
        async with asyncio.timeout(START_TIME):
            while (await client.call("robot.connect")).decision != "accepted":  # noqa: ASYNC110
                await asyncio.sleep(0.2)
        (successor,) = daemon.children()
    assert daemon.end() == 0
    assert not any(map(is_running, (heart, node, successor)))
