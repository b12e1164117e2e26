"""Requests of one sender keep their order and wait for no other; without an answer the outcome is unknown."""

from __future__ import annotations

import asyncio
import threading
from concurrent.futures import ThreadPoolExecutor
from typing import Any, cast

import msgspec
import pytest

from pcmrs.bus.qos import COMMANDS
from pcmrs.bus.requests import send_query
from pcmrs.bus.seal import Seal, new_key, new_run
from pcmrs.errors import UnknownOutcomeError
from pcmrs.messages import DeviceReply, DeviceRequest
from tests.unit.bus.bus_cells import TIMEOUT, new_cell, open_bus, open_pair


class SlowSession:
    """A Zenoh session whose sends of some payloads block."""

    def __init__(self) -> None:
        self.sent: list[bytes] = []
        self.blocked = {name: threading.Event() for name in (b"follow 1",)}

    def get(self, _key: str, handler: Any, *, payload: bytes, **_more: Any) -> None:
        if payload in self.blocked:
            self.blocked[payload].wait(10.0)
        self.sent.append(payload)
        handler.drop()


@pytest.fixture
def quiet_handler(monkeypatch: pytest.MonkeyPatch) -> None:
    class Handler:
        def __init__(self, _callback: Any, drop: Any, **_more: Any) -> None:
            self.drop = drop

    monkeypatch.setattr("pcmrs.bus.requests.zenoh.handlers.Callback", Handler)


@pytest.mark.usefixtures("quiet_handler")
async def test_blocked_sender_keeps_its_order_and_delays_no_other() -> None:
    session = SlowSession()
    acting, holding = ThreadPoolExecutor(1), ThreadPoolExecutor(1)

    async def send(pool: ThreadPoolExecutor, what: bytes) -> None:
        await asyncio.gather(send_query(cast("Any", session), pool, "k", what, 1.0, COMMANDS), return_exceptions=True)

    first, second = (asyncio.create_task(send(acting, what)) for what in (b"follow 1", b"follow 2"))
    await asyncio.wait_for(send(holding, b"hold"), 10.0)
    assert session.sent == [b"hold"], "it waits for no send that blocks"
    session.blocked[b"follow 1"].set()
    await asyncio.gather(first, second)
    assert session.sent == [b"hold", b"follow 1", b"follow 2"]
    for pool in (acting, holding):
        pool.shutdown()


@pytest.mark.usefixtures("quiet_handler")
async def test_unsent_request_is_recalled_when_its_caller_is_cancelled() -> None:
    session = SlowSession()
    acting = ThreadPoolExecutor(1)
    first, second = (
        asyncio.create_task(send_query(cast("Any", session), acting, "k", what, 1.0, COMMANDS))
        for what in (b"follow 1", b"follow 2")
    )
    await asyncio.sleep(0)
    second.cancel()
    await asyncio.gather(second, return_exceptions=True)
    session.blocked[b"follow 1"].set()
    await asyncio.gather(first, return_exceptions=True)
    acting.shutdown()
    assert session.sent == [b"follow 1"]


async def test_requests_of_one_sender_arrive_in_their_order() -> None:
    heard: list[int] = []

    async def answer(_key: str, request: DeviceRequest) -> DeviceReply:
        heard.append(int(request.method))
        return DeviceReply()

    async with open_pair() as (router, client):
        router.serve("dev/robot/cmd", DeviceRequest, answer)
        requests = [DeviceRequest(method=str(number)) for number in range(200)]
        await asyncio.gather(*(client.request("dev/robot/cmd", each, DeviceReply, 10.0, "robot") for each in requests))
    assert heard == list(range(200))


async def test_nobody_serving_and_silence_are_unknown_outcomes() -> None:
    async with open_pair() as (router, client):
        with pytest.raises(UnknownOutcomeError):
            await client.request("dev/nobody/cmd", DeviceRequest(method="joints"), DeviceReply, TIMEOUT)

        async def never(_: str, __: DeviceRequest) -> DeviceReply:
            await asyncio.Event().wait()
            raise AssertionError

        router.serve("dev/robot/cmd", DeviceRequest, never)
        with pytest.raises(UnknownOutcomeError):
            await client.request("dev/robot/cmd", DeviceRequest(method="follow"), DeviceReply, 0.2)


async def test_a_silence_is_no_forged_reply() -> None:
    """Zenoh ends a query at its limit by an error of its own, which has no seal."""
    settings, key = new_cell(), new_key()

    async def never(_: str, __: DeviceRequest) -> DeviceReply:
        await asyncio.Event().wait()
        raise AssertionError

    client = msgspec.structs.replace(settings, mode="client")
    async with (
        open_bus(settings, Seal(key + new_run(), daemon=True)) as daemon,
        open_bus(client, Seal(key)) as node,
    ):
        node.serve("dev/robot/cmd", DeviceRequest, never)
        with pytest.raises(UnknownOutcomeError):
            await daemon.request("dev/robot/cmd", DeviceRequest(method="follow"), DeviceReply, 0.3)
        assert daemon.counters()["bus.not_sealed"] == 0
