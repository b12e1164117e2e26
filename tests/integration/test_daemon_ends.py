"""How a daemon ends, by its own will or not, and what the next one makes of it."""

from __future__ import annotations

import asyncio
import os
import signal
from collections.abc import AsyncGenerator, AsyncIterator
from contextlib import aclosing, suppress
from pathlib import Path

import pytest
from daemon_process import PATIENCE, SLOW, is_running, own_settings, running_daemon, wait_until
from driving import accepted, approaching, register, stands_still

from pcmrs.client import Event
from pcmrs.errors import UnknownOutcomeError
from pcmrs.journal import JournalReader, JournalRow
from pcmrs.messages import Snapshot

NODE_ENDS_WITHIN = 2.0


def _rows(folder: Path) -> list[JournalRow]:
    with JournalReader(folder / "ratms.sqlite") as journal:
        return [stored.row for stored in journal.read(after=0)]


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
async def test_a_signal_holds_the_motion_before_everything_ends(tmp_path: Path, number: int) -> None:
    with running_daemon([*own_settings(tmp_path), *SLOW], tmp_path) as daemon:
        nodes = daemon.children()
        async with daemon.client() as client, approaching(daemon, client) as approach:
            status = await asyncio.to_thread(daemon.end, number)
            with suppress(UnknownOutcomeError):  # the bus may be closed before the answer is through
                assert (await approach).state == "held"
        assert status == 0
        assert nodes
        assert not any(map(is_running, nodes))
        assert "Traceback" not in daemon.log
    outcome = next(row for row in reversed(_rows(tmp_path)) if row.operation == "approach" and row.verdict)
    assert outcome.verdict is not None
    assert outcome.verdict.decision == "failed"
    assert outcome.verdict.state == "held"


async def test_nodes_end_by_themselves_after_the_daemon_is_killed_and_its_successor_knows_nothing(
    tmp_path: Path,
) -> None:
    settings = [*own_settings(tmp_path), *SLOW]
    with running_daemon(settings, tmp_path) as daemon:
        nodes = daemon.children()
        async with daemon.client() as client:
            planned = await client.call("registration.clear_landmarks", id="before-the-crash")
            async with approaching(daemon, client) as approach:
                daemon.end(signal.SIGKILL)
                with pytest.raises(UnknownOutcomeError):
                    await approach
        assert wait_until(lambda: not any(map(is_running, nodes)), NODE_ENDS_WITHIN)
    with running_daemon(settings, tmp_path) as successor:
        async with successor.client() as client:
            state = await client.state()
            assert state.branches == {
                "registration": "000",
                "digitization": "0",
                "toolplan": "0",
                "robot": "0",
                "placement": "unknown",
                "alignment": "0",
            }
            assert await client.call("registration.clear_landmarks", id="before-the-crash") == planned
            await accepted(client, "robot.connect")
        assert "Traceback" not in successor.log
    (lost,) = (row for row in _rows(tmp_path) if row.verdict is not None and row.verdict.decision == "unknown")
    assert (lost.branch, lost.operation) == ("placement", "approach")


async def test_the_node_holds_the_arm_while_the_daemon_is_frozen(tmp_path: Path) -> None:
    with running_daemon([*own_settings(tmp_path), *SLOW], tmp_path) as daemon:
        async with daemon.client() as client:
            async with approaching(daemon, client) as approach:
                daemon.process.send_signal(signal.SIGSTOP)
                held = await asyncio.to_thread(wait_until, lambda: "held_by_node" in daemon.log)
                daemon.process.send_signal(signal.SIGCONT)
                assert held
                verdict = await approach
            assert verdict.decision in ("failed", "unknown")
            assert verdict.state in ("held", "unknown")
            assert await stands_still(client)
        assert "Traceback" not in daemon.log


async def test_a_dead_node_is_a_lost_robot(tmp_path: Path) -> None:
    with running_daemon(own_settings(tmp_path), tmp_path) as daemon:
        async with daemon.client() as client, aclosing(client.watch()) as events:
            await register(client)
            (node,) = daemon.children()
            os.kill(node, signal.SIGKILL)
            async with asyncio.timeout(PATIENCE):
                lost = [event async for event in until_robot_is_off(events)][-1]
            assert lost.branches["placement"] == "unknown"
            assert lost.latched
            failed = await client.call("robot.connect")
            assert failed.decision == "unknown"
            assert failed.state == "0"
        assert daemon.end() == 0
        assert "Traceback" not in daemon.log


async def until_robot_is_off(events: AsyncGenerator[Event, None]) -> AsyncIterator[Snapshot]:
    was_on = False
    async for event in events:
        if isinstance(event, Snapshot):
            yield event
            was_on = was_on or event.branches["robot"] == "1"
            if was_on and event.branches["robot"] == "0":
                return
