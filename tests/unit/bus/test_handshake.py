"""A process that has the key asks the daemon which messages are of its present run."""

from __future__ import annotations

import asyncio
import threading
from concurrent.futures import ThreadPoolExecutor
from contextlib import AsyncExitStack

import msgspec
import pytest
import zenoh

from pcmrs.bus.handshake import RUN, WAITING, Handshake
from pcmrs.bus.seal import LENGTH, Seal, new_key, new_run
from pcmrs.bus.settings import open_session
from pcmrs.messages import Beat, DeviceReply, DeviceRequest
from tests.unit.bus.bus_cells import TIMEOUT, new_cell, open_bus, plain_session


async def test_first_request_of_a_restarted_daemon_is_answered() -> None:
    """The node continues on another machine; a daemon that does not know whether its arm stands sends no heartbeats."""
    settings, key = new_cell(), new_key()
    client = msgspec.structs.replace(settings, mode="client")
    asked: list[str] = []

    async def answer(_key: str, request: DeviceRequest) -> DeviceReply:
        asked.append(request.method)
        return DeviceReply(result=request.method)

    async with AsyncExitStack() as node_stack:
        async with open_bus(settings, Seal(key + new_run(), daemon=True)):
            node = await node_stack.enter_async_context(open_bus(client, Seal(key)))
            node.serve("dev/robot/cmd", DeviceRequest, answer)
        async with open_bus(settings, Seal(key + new_run(), daemon=True)) as daemon:
            there: asyncio.Queue[str] = asyncio.Queue()
            loop = asyncio.get_running_loop()
            with plain_session(settings) as stranger:
                stranger.liveliness().declare_subscriber(
                    daemon.prefix + "/alive/*",
                    lambda sample: loop.call_soon_threadsafe(there.put_nowait, str(sample.key_expr)),
                    history=True,
                )
                node.alive("node")
                await asyncio.wait_for(there.get(), TIMEOUT)  # the node has connected again
            request = DeviceRequest(method="hold")
            assert (await daemon.request("dev/robot/cmd", request, DeviceReply, TIMEOUT)).result == "hold"
    assert asked == ["hold"]


async def test_node_that_only_sends_notices_a_restarted_daemon() -> None:
    """Such as that of a tracker, which subscribes to nothing and serves nothing."""
    settings, key = new_cell(), new_key()
    beats: list[str] = []
    async with AsyncExitStack() as node_stack:
        async with open_bus(settings, Seal(key + new_run(), daemon=True)):
            node = await node_stack.enter_async_context(
                open_bus(msgspec.structs.replace(settings, mode="client"), Seal(key))
            )
        async with open_bus(settings, Seal(key + new_run(), daemon=True)) as daemon, asyncio.timeout(TIMEOUT):
            daemon.listen("dev/*/beat", Beat, lambda key, _: beats.append(key))
            while not beats:
                node.publish("dev/tracker/beat", Beat(number=1, session="a", alive=0.0, sent=0.0))
                await asyncio.sleep(0.01)


async def test_query_that_a_stranger_keeps_open_delays_nobody(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("pcmrs.bus.handshake.QUESTION_TIME", 60.0)
    settings, key = new_cell(), new_key()
    kept: list[zenoh.Query] = []
    confirmed = asyncio.Event()
    loop = asyncio.get_running_loop()
    async with open_bus(settings, Seal(key + new_run(), daemon=True)) as daemon:
        with plain_session(settings) as stranger, plain_session(settings) as session, ThreadPoolExecutor(1) as pool:
            stranger.declare_queryable(f"{daemon.prefix}/{RUN}", kept.append)
            while not kept:  # until the daemon knows the stranger
                list(session.get(f"{daemon.prefix}/{RUN}", timeout=0.05))
            kept.clear()
            handshake = Handshake(session, f"{daemon.prefix}/{RUN}", Seal(key), pool, lambda *_: None)
            assert handshake.begin(lambda: loop.call_soon_threadsafe(confirmed.set))
            await asyncio.wait_for(confirmed.wait(), TIMEOUT)
            assert len(kept) == 1, "the query is still open there"
            kept.clear()


def test_request_behind_a_question_on_its_way_gets_its_own() -> None:
    """The question on its way may have reached an earlier daemon."""
    settings = new_cell()
    asked: list[str] = []
    arrived, ended = threading.Event(), threading.Semaphore(0)
    free = threading.Event()

    def serve(query: zenoh.Query) -> None:
        asked.append(str(query.key_expr))
        arrived.set()
        free.wait(TIMEOUT)
        with query:
            pass

    with open_session(settings) as server, plain_session(settings) as session, ThreadPoolExecutor(2) as pool:
        key = f"pcmrs/test/{settings.cell}/{RUN}"
        server.declare_queryable(key, serve)
        handshake = Handshake(session, key, Seal(new_key()), pool, lambda *_: None)
        assert handshake.begin()
        assert arrived.wait(TIMEOUT)
        assert handshake.begin(ended.release)
        free.set()
        assert ended.acquire(timeout=TIMEOUT)
    assert len(asked) == 2


async def test_a_stranger_gets_no_answer() -> None:
    settings, key = new_cell(), new_key()
    async with open_bus(settings, Seal(key + new_run(), daemon=True)) as daemon:
        with plain_session(settings) as stranger:
            for attached in (None, bytes(LENGTH), Seal(new_key()).put("question", f"{daemon.prefix}/{RUN}", b"")):
                replies = stranger.get(f"{daemon.prefix}/{RUN}", attachment=attached)
                assert await asyncio.to_thread(list, replies) == []
        assert daemon.counters()["bus.not_sealed"] == 3


async def test_foreign_answer_confirms_nothing() -> None:
    """Somebody without the key serves the key of the daemon's answers, where no daemon is."""
    settings, key = new_cell(), new_key()
    asked: list[str] = []

    def forge(query: zenoh.Query) -> None:
        asked.append(str(query.key_expr))
        with query:
            query.reply(f"{router.prefix}/{RUN}", b"", attachment=bytes(LENGTH))

    async with open_bus(settings) as router:
        with plain_session(settings) as stranger:
            stranger.declare_queryable(f"{router.prefix}/{RUN}", forge)
            while not asked:
                seal = Seal(key)
                async with open_bus(msgspec.structs.replace(settings, mode="client"), seal) as node:
                    assert node.counters()["bus.not_sealed"] == len(asked)
                    assert not seal.is_confirmed


async def test_a_node_with_another_key_logs_it(caplog: pytest.LogCaptureFixture) -> None:
    settings = new_cell()
    async with open_bus(settings, Seal(new_key() + new_run(), daemon=True)) as daemon:
        async with open_bus(msgspec.structs.replace(settings, mode="client"), Seal(new_key())):
            pass
        assert daemon.counters()["bus.not_sealed"] == 1
    assert "Compare access.device_key on both sides" in caplog.text


async def test_node_without_an_answer_asks_again_at_a_message() -> None:
    """Its daemon was too busy to answer when the node started."""
    settings, key = new_cell(), new_key() + new_run()
    beats: list[Beat] = []
    async with AsyncExitStack() as node_stack:
        async with open_bus(settings):
            client = msgspec.structs.replace(settings, mode="client")
            node = await node_stack.enter_async_context(open_bus(client, Seal(key)))
            node.listen("daemon/beat", Beat, lambda _, beat: beats.append(beat))
        async with open_bus(settings, Seal(key, daemon=True)) as daemon, asyncio.timeout(TIMEOUT):
            while not beats:
                daemon.publish("daemon/beat", Beat(number=1, session="a", alive=0.0, sent=0.0))
                await asyncio.sleep(0.01)


def test_the_number_of_requests_that_wait_is_limited() -> None:
    settings = new_cell()
    free, ended = threading.Event(), threading.Semaphore(0)
    with open_session(settings) as session, ThreadPoolExecutor(1) as pool:
        pool.submit(free.wait)  # the question is not sent yet
        handshake = Handshake(session, f"pcmrs/test/{settings.cell}/{RUN}", Seal(new_key()), pool, lambda *_: None)
        assert [handshake.begin(ended.release) for _ in range(WAITING + 1)] == [True] * WAITING + [False]
        assert handshake.begin()
        free.set()
        for _ in range(WAITING):
            assert ended.acquire(timeout=TIMEOUT)
        assert handshake.begin(ended.release)
        assert ended.acquire(timeout=TIMEOUT)
