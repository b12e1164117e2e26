"""No signed command begins before the disk has its counter, except Stop."""

from __future__ import annotations

import asyncio
import os
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from pcmrs.testing.clock import settle
from tests.unit.gateway.signed_room import Room, open_room, peer, told


class Disk:
    """Stands between the gateway and its disk: breaks, or answers when it is told to."""

    def __init__(self) -> None:
        self.error: OSError | None = None
        self._answers = threading.Event()
        self._answers.set()
        self._sync = os.fdatasync

    @contextmanager
    def hanging(self) -> Iterator[None]:
        self._answers.clear()
        try:
            yield
        finally:
            self._answers.set()

    def fdatasync(self, descriptor: int) -> None:
        if self.error is not None:
            raise self.error
        self._answers.wait(10.0)
        self._sync(descriptor)


@pytest.fixture
async def disk(monkeypatch: pytest.MonkeyPatch) -> Disk:
    made = Disk()
    monkeypatch.setattr("pcmrs.gateway.auth.counters.os.fdatasync", made.fdatasync)
    return made


async def test_a_counter_that_cannot_be_kept_refuses_its_command(disk: Disk, room: Room) -> None:
    disk.error = OSError(5, "Input/output error")
    assert await room.ask("rob_conn_onxxxxx_#1;") == "1_rejected_robot_1_counter_not_kept;"
    assert room.core.commands == []
    assert room.gateway.counters.of_peers["counter_not_kept"] == 1
    assert (await room.ask("stop_now_xxxxxxx_#2;")).startswith("2_accepted")
    assert room.core.stops == ["peer:planner"]
    assert "counter_not_kept" in told(room)
    disk.error = None
    assert (await room.ask("rob_conn_onxxxxx_#3;")).startswith("3_accepted")


async def test_nothing_begins_before_the_disk_has_its_counter_but_stop(disk: Disk, room: Room) -> None:
    with disk.hanging():
        await room.hear(room.sign("rob_conn_onxxxxx_#1;"))
        await settle()
        assert room.core.commands == []
        assert (await room.ask("stop_now_xxxxxxx_#2;")).startswith("2_accepted")
    assert await room.client.received.get() == "1_rejected_robot_1_stopped;"
    assert room.core.commands == []
    assert (await room.ask("rob_conn_onxxxxx_#3;")).startswith("3_accepted")


async def test_command_that_waited_too_long_for_the_disk_never_starts(disk: Disk, room: Room) -> None:
    with disk.hanging():
        await room.hear(room.sign("rob_conn_onxxxxx_#1;"))
        await settle()
        await room.clock.advance(1.0)
        assert await room.client.received.get() == "1_rejected_robot_1_counter_not_kept;"
    assert (await room.ask("get_jnt_angsxxxx_#2;")).startswith("2_accepted")
    assert room.core.commands == []


async def test_a_motion_that_waited_long_for_the_disk_never_begins(disk: Disk, room: Room) -> None:
    with disk.hanging():
        await room.hear(room.sign("execute_homexxxx_#1;"))
        await settle()
        await room.clock.advance(0.2)
    assert await room.client.received.get() == "1_rejected_placement_retracted_expired;"
    assert room.core.commands == []


async def test_so_many_of_a_peer_wait_for_the_disk(disk: Disk, room: Room) -> None:
    with disk.hanging():
        for number in range(70):
            await room.hear(room.sign(f"rob_conn_onxxxxx_#{number};"))
        refused = [await room.client.received.get() for _ in range(6)]
        assert all(reply.endswith("_queue_full;") for reply in refused)
        assert room.gateway.counters.overflowed == 6
    accepted = [await room.client.received.get() for _ in range(64)]
    assert [reply.split("_")[0] for reply in accepted] == [str(number) for number in range(64)]
    assert len(room.core.commands) == 64


async def test_waiting_command_never_starts_when_the_gateway_closes(disk: Disk, tmp_path: Path) -> None:
    opening = open_room(tmp_path, {"planner": peer(tmp_path, "planner")})
    room = await opening.__aenter__()
    with disk.hanging():
        waits = room.sign("rob_conn_onxxxxx_#1;")
        await room.hear(waits)
        closing = asyncio.ensure_future(opening.__aexit__(None, None, None))
        await settle()
    await closing
    assert room.core.commands == []
    async with open_room(tmp_path, {"planner": peer(tmp_path, "planner")}) as again:
        await again.hear(waits)
        assert again.gateway.counters.of_peers["old_counter"] == 1
