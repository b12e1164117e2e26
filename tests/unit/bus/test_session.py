"""Bus: messages, streams and requests over real Zenoh sessions on a separate port."""

import asyncio
import json
import sys
import threading
import time
from contextlib import suppress
from typing import Any

import msgspec
import pytest
import zenoh

from pcmrs.bus import Bus
from pcmrs.bus.bridge import CAPACITY
from pcmrs.bus.codec import pack
from pcmrs.devices.link import Link
from pcmrs.errors import PayloadError, UnknownOutcomeError
from pcmrs.messages import BodyPose, Command, DeviceReply, DeviceRequest, Reason, Verdict
from pcmrs.testing.waiting import wait_until
from tests.unit.bus.bus_cells import TIMEOUT, accepted, new_cell, open_bus, open_pair, plain_session, pose, sync


async def echo(key: str, request: DeviceRequest) -> DeviceReply:
    return DeviceReply(result={"key": key, "method": request.method, **request.arguments})


async def test_messages_arrive_in_the_loop_with_their_relative_key() -> None:
    async with open_pair() as (router, client):
        received: asyncio.Queue[tuple[str, BodyPose]] = asyncio.Queue()
        router.subscribe("state/pose/*", BodyPose, lambda key, message: received.put_nowait((key, message)))
        client.publish("state/pose/coil", pose(3))
        assert await asyncio.wait_for(received.get(), TIMEOUT) == ("state/pose/coil", pose(3))


async def test_flood_of_invalid_messages_is_counted_and_hardly_logged(caplog: pytest.LogCaptureFixture) -> None:
    async with open_pair() as (router, client):
        received: asyncio.Queue[BodyPose] = asyncio.Queue()
        router.subscribe("dev/robot/event", BodyPose, lambda _, message: received.put_nowait(message))
        for _ in range(200):
            client.publish("dev/robot/event", {"no": "pose"})
        client.publish("dev/robot/event", pose(1))
        await asyncio.wait_for(received.get(), TIMEOUT)
        assert router.counters()["bus.ignored"] == 200
        assert 1 <= sum("Ignored a message on dev/robot/event" in line for line in caplog.messages) < 20


async def test_listener_receives_although_the_loop_is_busy() -> None:
    async with open_pair() as (router, client):
        came = threading.Event()
        router.listen("daemon/beat", BodyPose, lambda _, message: came.set() if message.frame_number == 3 else None)
        arrived: asyncio.Queue[BodyPose] = asyncio.Queue()
        router.subscribe("dev/*/event", BodyPose, lambda _, message: arrived.put_nowait(message))
        client.publish("dev/robot/event", pose(1))
        await asyncio.wait_for(arrived.get(), TIMEOUT)  # the two know each other
        client.publish("daemon/beat", {"no": "pose"})
        client.publish("daemon/beat", pose(3))
        assert came.wait(TIMEOUT), "this thread is the loop's"
        assert router.counters()["bus.ignored"] == 1


async def test_busy_loop_gets_the_newest_of_a_stream_and_all_events() -> None:
    async with open_pair() as (router, _):
        frames: list[int] = []
        events: list[int] = []
        done, seen = asyncio.Event(), asyncio.Event()

        def take(_: str, message: BodyPose) -> None:
            events.append(message.frame_number)
            if message.frame_number == 99:
                done.set()

        def see(_: str, message: BodyPose) -> None:
            frames.append(message.frame_number)
            if message.frame_number == 99:
                seen.set()

        router.subscribe("state/pose/coil", BodyPose, see)
        router.subscribe("state/event", BodyPose, take)
        with plain_session(router.settings) as session:
            for number in range(100):
                for key in ("state/pose/coil", "state/event"):
                    payload = pack(pose(number))
                    session.put(f"{router.prefix}/{key}", payload, congestion_control=zenoh.CongestionControl.BLOCK)
            # The loop has not had a turn since the first put.
            await asyncio.wait_for(done.wait(), TIMEOUT)
            await asyncio.wait_for(seen.wait(), TIMEOUT)
        assert events == list(range(100))
        assert frames == sorted(set(frames))


async def test_subscribers_of_one_process_each_receive_every_message() -> None:
    async with open_pair() as (router, client):
        heard = [Heard(client, key) for key in ("state/pose/coil", "state/pose/coil", "state/pose/*")]
        await sync(router, client)
        for number in range(5):
            router.publish("state/pose/coil", pose(number))
            assert [await each.next() for each in heard] == [number] * 3
        assert [each.waiting for each in heard] == [0] * 3


async def test_ended_subscription_is_silent_and_disturbs_no_other() -> None:
    async with open_pair() as (router, client):
        ended, kept = Heard(client, "state/pose/coil"), Heard(client, "state/pose/coil")
        await sync(router, client)
        router.publish("state/pose/coil", pose(1))
        assert [await ended.next(), await kept.next()] == [1, 1]
        await ended.end()
        later = Heard(client, "state/pose/coil")
        await sync(router, client)
        router.publish("state/pose/coil", pose(2))
        assert [await kept.next(), await later.next()] == [2, 2]
        assert ended.waiting == 0
    await ended.end()  # the closed bus has ended it too


async def test_malformed_message_is_ignored_and_the_next_received() -> None:
    async with open_pair() as (router, _):
        received: asyncio.Queue[int] = asyncio.Queue()
        refused: asyncio.Queue[str] = asyncio.Queue()
        router.subscribe(
            "state/event",
            BodyPose,
            lambda _, message: received.put_nowait(message.frame_number),
            refuse=lambda key, error: refused.put_nowait(f"{key}: {error.code}"),
        )
        with plain_session(router.settings) as session:
            session.put(f"{router.prefix}/state/event", b"\xc1garbage")
            session.put(f"{router.prefix}/state/event", pack(pose(8)))
            assert await asyncio.wait_for(received.get(), TIMEOUT) == 8
        assert refused.get_nowait() == "state/event: malformed"


@pytest.mark.parametrize("backwards", [False, True])
async def test_requests_are_answered_in_both_directions(backwards: bool) -> None:
    async with open_pair() as pair:
        server, asker = reversed(pair) if backwards else pair
        server.serve("dev/*/cmd", DeviceRequest, echo)
        if backwards:
            # Once its own request is answered, the router knows what the client serves.
            await sync(asker, server)
        request = DeviceRequest(method="joints", arguments={"x": 1.5})
        reply = await asker.request("dev/robot/cmd", request, DeviceReply, TIMEOUT)
        assert reply.result == {"key": "dev/robot/cmd", "method": "joints", "x": 1.5}


class Heard:
    """What one subscription hears. Streams have a lane of their own: an answer that has come does not say they have."""

    def __init__(self, bus: Bus, key: str) -> None:
        self._frames: asyncio.Queue[int] = asyncio.Queue()
        self.end = bus.subscribe(key, BodyPose, lambda _, message: self._frames.put_nowait(message.frame_number))

    @property
    def waiting(self) -> int:
        return self._frames.qsize()

    async def next(self) -> int:
        return await asyncio.wait_for(self._frames.get(), TIMEOUT)


SERVER = """
import asyncio, sys
import msgspec
from pcmrs.bus import Bus, BusSettings
from pcmrs.messages import DeviceReply, DeviceRequest

async def main():
    bus = await Bus.open(msgspec.json.decode(sys.argv[1], type=BusSettings))
    async def handle(key, request):
        if request.method == "follow":
            print("moving", flush=True)
            await asyncio.Event().wait()
        return DeviceReply(result=request.method)
    bus.serve("dev/robot/cmd", DeviceRequest, handle)
    print("ready", flush=True)
    await asyncio.Event().wait()

asyncio.run(main())
"""


async def test_other_process_answers_and_its_death_is_noticed_at_once() -> None:
    settings = new_cell()
    arguments = ("-c", SERVER, msgspec.json.encode(settings).decode())
    server = await asyncio.create_subprocess_exec(sys.executable, *arguments, stdout=asyncio.subprocess.PIPE)
    assert server.stdout is not None
    try:
        assert await server.stdout.readline() == b"ready\n"
        async with open_bus(msgspec.structs.replace(settings, mode="client")) as client:
            ask = DeviceRequest(method="joints")
            assert (await client.request("dev/robot/cmd", ask, DeviceReply, TIMEOUT)).result == "joints"
            request = client.request("dev/robot/cmd", DeviceRequest(method="follow"), DeviceReply, 600.0)
            pending = asyncio.ensure_future(request)
            assert await server.stdout.readline() == b"moving\n"
            server.kill()
            with pytest.raises(UnknownOutcomeError):
                await asyncio.wait_for(pending, TIMEOUT)
    finally:
        with suppress(ProcessLookupError):
            server.kill()
        await server.wait()


async def test_names_that_are_no_part_of_a_key_are_refused() -> None:
    with pytest.raises(PayloadError, match="Lab/1"):
        await Bus.open(msgspec.structs.replace(new_cell(), site="Lab/1"))


async def test_a_liveliness_token_lasts_as_long_as_the_session() -> None:
    settings = new_cell()
    async with open_bus(settings):
        with plain_session(settings) as session:
            events: asyncio.Queue[tuple[str, zenoh.SampleKind]] = asyncio.Queue()
            loop = asyncio.get_running_loop()
            session.liveliness().declare_subscriber(
                "pcmrs/**",
                lambda sample: loop.call_soon_threadsafe(
                    events.put_nowait, (str(sample.key_expr).rpartition("/")[2], sample.kind)
                ),
                history=True,
            )
            async with open_bus(msgspec.structs.replace(settings, mode="client")) as node:
                node.alive("robot")
                assert await asyncio.wait_for(events.get(), TIMEOUT) == ("robot", zenoh.SampleKind.PUT)
            assert await asyncio.wait_for(events.get(), TIMEOUT) == ("robot", zenoh.SampleKind.DELETE)


async def test_the_bus_is_the_link_that_devices_need() -> None:
    async with open_pair() as (router, _):
        link: Link = router
        assert link is router


async def test_an_event_that_finds_the_queue_full_is_reported() -> None:
    async with open_pair() as (router, client):
        lost = asyncio.Queue[str]()
        arrived = asyncio.Queue[BodyPose]()
        router.subscribe("dev/*/event", BodyPose, lambda _, message: arrived.put_nowait(message))
        router.when_lost(lost.put_nowait)
        client.publish("dev/robot/event", pose(0))
        await asyncio.wait_for(arrived.get(), TIMEOUT)  # the two know each other
        with plain_session(router.settings) as session:
            for number in range(CAPACITY + 1):
                payload = pack(pose(number))
                key = f"{router.prefix}/dev/robot/event"
                session.put(key, payload, congestion_control=zenoh.CongestionControl.BLOCK)
            while router.counters()["bus.refused"] == 0:
                time.sleep(0.001)  # noqa: ASYNC251  # this thread is the loop's: nothing is taken out of the queue
            assert lost.empty()
            assert await asyncio.wait_for(lost.get(), TIMEOUT) == "dev/robot/event"
        assert lost.empty(), "it is reported once, until that was heard"


async def test_state_and_events_are_sent_as_text_to_who_asks_for_it() -> None:
    """A command-line client reads the verdict on its put; the binary key stays as it was."""
    settings = new_cell()
    async with open_bus(settings) as router:
        with plain_session(settings) as session:
            texts = session.declare_subscriber(f"{router.prefix}/json/state/event")
            packed = session.declare_subscriber(f"{router.prefix}/state/event")
            verdict = accepted(Command(id="c1", branch="robot", operation="connect", source="bus:eve"))
            await until_text_matches(router, verdict)
            text = await asyncio.to_thread(texts.recv)
            assert str(text.encoding) == "application/json"
            assert json.loads(text.payload.to_bytes())["decision"] == "accepted"
            assert (await asyncio.to_thread(packed.recv)).payload.to_bytes() == pack(verdict)


async def test_without_a_subscriber_no_text_is_made(monkeypatch: pytest.MonkeyPatch) -> None:
    def pack_text(message: Any) -> bytes:
        raise AssertionError(message)

    monkeypatch.setattr("pcmrs.bus._session.pack_text", pack_text)
    async with open_pair() as (router, client):
        events: asyncio.Queue[dict[str, Any]] = asyncio.Queue()
        client.subscribe("state/event", dict, lambda _, event: events.put_nowait(event))
        router.publish("state/event", Reason(code="first", text=""))
        await asyncio.wait_for(events.get(), TIMEOUT)
        router.publish("state/event", Reason(code="second", text=""))
        assert (await asyncio.wait_for(events.get(), TIMEOUT))["code"] == "second"


async def until_text_matches(router: Bus, verdict: Verdict) -> None:
    """Publish until the subscription to the text has reached the publisher."""
    router.publish("state/event", verdict)
    copies: Any = router._publisher("json/state/event")
    await wait_until(lambda: copies.matching_status.matching)
    router.publish("state/event", verdict)
