"""Counters of signed peers outlive the daemon, whatever ends it."""

from __future__ import annotations

import asyncio
import os
import resource
import threading
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pcmrs.errors import ConfigurationError
from pcmrs.gateway.auth.counters import MOST_NAMES, CounterFile, CounterWriter, check_room
from pcmrs.gateway.links import COUNTERS, open_gateway
from pcmrs.gateway.settings import MAX_PEERS
from pcmrs.testing.clock import ManualClock, settle
from tests.unit.gateway.gateway_fakes import FakeCore
from tests.unit.gateway.signed_room import config, open_room, peer

FULL = {f"{number:032}": 10**19 - 1 for number in range(MOST_NAMES)}


async def test_counters_survive_a_restart_each_peer_its_own(tmp_path: Path) -> None:
    peers = {name: peer(tmp_path, name) for name in ("planner", "panel")}
    async with open_room(tmp_path, peers) as room:
        old = [room.sign(f"rob_conn_onxxxxx_#{number};") for number in range(3)]
        for data in old:
            await room.hear(data)
            await room.client.received.get()
        stop = room.sign("stop_now_xxxxxxx;")
        await room.hear(stop)
    async with open_room(tmp_path, peers) as room:
        for data in (*old, stop):
            await room.hear(data)
        assert (await room.ask("rob_conn_onxxxxx_#1;", "panel")).startswith("1_accepted")
        assert room.gateway.counters.of_peers["old_counter"] == 4
        assert room.core.stops == []
        assert len(room.core.commands) == 1


async def test_a_peer_that_was_away_is_not_replayed(tmp_path: Path) -> None:
    both = {name: peer(tmp_path, name) for name in ("planner", "panel")}
    async with open_room(tmp_path, both) as room:
        old = room.sign("rob_conn_onxxxxx_#1;")
        await room.hear(old)
        await room.client.received.get()
    async with open_room(tmp_path, {"panel": both["panel"]}) as room:
        assert (await room.ask("rob_conn_onxxxxx_#1;", "panel")).startswith("1_accepted")
    async with open_room(tmp_path, both) as room:
        await room.hear(old)
        assert room.gateway.counters.of_peers["old_counter"] == 1


@given(st.lists(st.dictionaries(st.sampled_from(sorted(FULL)), st.integers(1, 10**19 - 1)), min_size=1, max_size=4))
def test_last_written_counters_are_read(tmp_path_factory: pytest.TempPathFactory, tables: list[dict[str, int]]) -> None:
    path = tmp_path_factory.mktemp("counters") / COUNTERS
    for table in tables:
        file = CounterFile(path)
        file.write(table)
        file.close()
    again = CounterFile(path)
    again.close()
    assert again.kept == tables[-1]


def test_the_file_does_not_grow(tmp_path: Path) -> None:
    file = CounterFile(tmp_path / COUNTERS)
    size = (tmp_path / COUNTERS).stat().st_size
    for _ in range(5):
        file.write(FULL)
    file.close()
    assert (tmp_path / COUNTERS).stat().st_size == size


@pytest.mark.parametrize("cut", [0, 1, 20, 100, 3000, 8191])
def test_a_torn_write_leaves_what_was_kept_before(tmp_path: Path, cut: int) -> None:
    path = tmp_path / COUNTERS
    file = CounterFile(path)
    file.write({"planner": 5})
    before = path.read_bytes()
    file.write(FULL)
    after = path.read_bytes()
    file.close()
    start = next(index for index in range(len(after)) if after[index] != before[index]) // 8192 * 8192
    path.write_bytes(before[:start] + after[start : start + cut] + before[start + cut :])
    torn = CounterFile(path)
    torn.close()
    assert torn.kept in ({"planner": 5}, FULL)
    assert torn.kept == {"planner": 5} or cut == 8191


def test_partial_write_is_an_error_and_the_next_whole_one_counts(tmp_path: Path) -> None:
    """As on a full disk; here the limit of a file's size cuts what is written into the second slot."""
    path = tmp_path / COUNTERS
    file = CounterFile(path)
    file.write({"planner": 4})
    file.write({"planner": 5})
    cut = path.read_bytes().index(b"planner", 8192) + 3
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    file.write({"planner": 6})
    resource.setrlimit(resource.RLIMIT_FSIZE, (cut, hard))
    try:
        for _ in range(2):
            with pytest.raises(OSError, match="only a part"):
                file.write({"planner": 7})
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    kept = CounterFile(path)
    kept.close()
    assert kept.kept == {"planner": 6}, "the other slot was not touched"
    file.write({"planner": 8})
    file.close()
    again = CounterFile(path)
    again.close()
    assert again.kept == {"planner": 8}


@pytest.mark.parametrize("content", [b"", b"x", b"\0" * 16384, b"PCMRSPC1" * 2048])
async def test_a_damaged_file_starts_nothing(tmp_path: Path, content: bytes) -> None:
    (tmp_path / COUNTERS).write_bytes(content)
    with pytest.raises(ConfigurationError, match=r"damaged.*new key"):
        async with open_gateway(FakeCore(), config({"a": peer(tmp_path, "a")}), ManualClock(), tmp_path):
            pass


async def test_a_file_that_cannot_be_made_starts_nothing(tmp_path: Path) -> None:
    key = peer(tmp_path, "a")
    (tmp_path / "file").touch()
    with pytest.raises(ConfigurationError, match="cannot be used"):
        async with open_gateway(FakeCore(), config({"a": key}), ManualClock(), tmp_path / "file"):
            pass


async def test_waiter_for_the_disk_is_cancelled_on_closing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Or else a command would begin while the daemon ends; its counter is kept nevertheless."""
    file, errors, answers = CounterFile(tmp_path / COUNTERS), list[OSError](), threading.Event()
    sync = os.fdatasync

    def hanging(descriptor: int) -> None:
        answers.wait(10.0)
        sync(descriptor)

    monkeypatch.setattr("pcmrs.gateway.auth.counters.os.fdatasync", hanging)
    keeper = CounterWriter(file, errors.append)
    waits = keeper.keep("planner", 5)
    closing = asyncio.create_task(keeper.close())
    await settle()
    assert not closing.done()
    answers.set()
    await closing
    await settle()
    assert waits.cancelled()
    assert errors == []
    file.close()
    again = CounterFile(tmp_path / COUNTERS)
    again.close()
    assert again.kept == {"planner": 5}


def test_as_many_peers_are_remembered_as_fit(tmp_path: Path) -> None:
    assert MAX_PEERS < MOST_NAMES
    check_room(FULL, dict.fromkeys(FULL), tmp_path)
    with pytest.raises(ConfigurationError, match=f"129 peers with those of earlier times, the limit is {MOST_NAMES}"):
        check_room(FULL, {"new": None}, tmp_path)
