"""Bus: real Zenoh sessions on a port of their own."""

import asyncio
import json
import sys
import threading
import time
from contextlib import suppress
from pathlib import Path

import msgspec
import pytest
import zenoh

from pcmrs.bus import Bus, BusSettings, Empty
from pcmrs.bus.codec import pack
from pcmrs.bus.serving import ANSWERS
from pcmrs.errors import BusError, DeviceError, PayloadError, RefusalError, UnknownOutcomeError
from pcmrs.messages import BodyPose, DeviceReply, DeviceRequest, Snapshot
from pcmrs.pki import Authority, read_credentials
from pcmrs.testing.daemon import free_port
from tests.unit.bus.bus_cells import TIMEOUT, new_cell, open_bus, open_pair, plain_session, snapshot


def pose(frame_number: int) -> BodyPose:
    return BodyPose(body="coil", frame_number=frame_number, captured=0.0, sent=0.0, valid=True)


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


async def test_a_late_joiner_gets_the_last_snapshot() -> None:
    async with open_pair() as (router, client):
        for sequence in range(5):
            router.publish("state/fsm", snapshot(sequence))
        received: asyncio.Queue[Snapshot] = asyncio.Queue()
        client.subscribe("state/fsm", Snapshot, lambda _, message: received.put_nowait(message))
        assert (await asyncio.wait_for(received.get(), TIMEOUT)).sequence == 4


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


async def test_a_process_does_not_hear_itself() -> None:
    async with open_pair() as (router, client):
        received: asyncio.Queue[int] = asyncio.Queue()
        router.subscribe("dev/robot/beat", BodyPose, lambda _, message: received.put_nowait(message.frame_number))
        router.publish("dev/robot/beat", pose(1))
        client.publish("dev/robot/beat", pose(2))
        assert await asyncio.wait_for(received.get(), TIMEOUT) == 2


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


async def sync(router: Bus, client: Bus) -> None:
    async def pong(_: str, __: Empty) -> Empty:
        return Empty()

    router.serve("svc/ping", Empty, pong)
    await client.request("svc/ping", Empty(), Empty, TIMEOUT)


async def test_requests_run_side_by_side() -> None:
    async with open_pair() as (router, client):
        meet = asyncio.Barrier(5)

        async def wait_for_all(key: str, request: DeviceRequest) -> DeviceReply:
            await meet.wait()
            return DeviceReply(result=request.method)

        router.serve("dev/robot/cmd", DeviceRequest, wait_for_all)
        asked = [client.request("dev/robot/cmd", DeviceRequest(method=f"m{n}"), DeviceReply, TIMEOUT) for n in range(5)]
        replies = await asyncio.wait_for(asyncio.gather(*asked), TIMEOUT)
        assert [reply.result for reply in replies] == [f"m{n}" for n in range(5)]


@pytest.mark.parametrize(
    ("raised", "code", "says"),
    [
        (RefusalError("too_far", "3 m are too far.", distance=3.0), "too_far", "3 m are too far"),
        (ZeroDivisionError("division by zero"), "error", "ZeroDivisionError"),
    ],
)
async def test_an_error_in_the_handler_is_raised_at_the_asker(raised: Exception, code: str, says: str) -> None:
    async def fail(_: str, __: DeviceRequest) -> DeviceReply:
        raise raised

    async with open_pair() as (router, client):
        router.serve("dev/robot/cmd", DeviceRequest, fail)
        with pytest.raises(DeviceError, match=says) as error:
            await client.request("dev/robot/cmd", DeviceRequest(method="follow"), DeviceReply, TIMEOUT)
        assert error.value.fields["reason"] == code


async def test_unsendable_reply_and_malformed_request_are_errors() -> None:
    async def answer_object(_: str, __: DeviceRequest) -> DeviceReply:
        return DeviceReply(result=object())

    async with open_pair() as (router, client):
        router.serve("dev/robot/cmd", DeviceRequest, answer_object)
        for request in (DeviceRequest(method="joints"), Empty()):
            with pytest.raises(DeviceError) as error:
                await client.request("dev/robot/cmd", request, DeviceReply, TIMEOUT)
            assert error.value.fields["reason"] == "malformed"


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


async def test_a_server_that_closes_leaves_its_askers_with_unknown() -> None:
    settings = new_cell()
    async with open_bus(settings) as router:
        server = await Bus.open(msgspec.structs.replace(settings, mode="client"))
        asked = asyncio.Event()

        async def never(_: str, __: DeviceRequest) -> DeviceReply:
            asked.set()
            await asyncio.Event().wait()
            raise AssertionError

        server.serve("dev/robot/cmd", DeviceRequest, never)
        await sync(router, server)
        request = router.request("dev/robot/cmd", DeviceRequest(method="follow"), DeviceReply, 600.0)
        pending = asyncio.ensure_future(request)
        await asyncio.wait_for(asked.wait(), TIMEOUT)
        await server.close()
        with pytest.raises(UnknownOutcomeError):
            await asyncio.wait_for(pending, TIMEOUT)


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


async def test_a_second_daemon_is_refused() -> None:
    settings = new_cell()
    async with open_bus(settings):
        with pytest.raises(BusError, match="another daemon") as error:
            await Bus.open(settings)
        assert error.value.fields["endpoint"] == settings.endpoint
    # A closed one frees the endpoint.
    async with open_bus(settings):
        pass


async def test_client_without_a_daemon_is_told_to_start_one() -> None:
    with pytest.raises(BusError, match="start pcmrs-serve"):
        await Bus.open(msgspec.structs.replace(new_cell(), mode="client"))


async def test_refused_certificate_holder_gets_the_possible_causes(tmp_path: Path) -> None:
    now = time.time()
    Authority.init(tmp_path / "pki", "lab", now).issue("operator", "anna", now, into=tmp_path)
    endpoint = f"tls/127.0.0.1:{free_port()}"
    settings = BusSettings(endpoint=endpoint, credentials=read_credentials(tmp_path / "anna", now))
    with pytest.raises(BusError, match=f"No router at {endpoint} accepts anna: none runs there, its certificate"):
        await Bus.open(settings)


async def test_names_that_are_no_part_of_a_key_are_refused() -> None:
    with pytest.raises(PayloadError, match="Lab/1"):
        await Bus.open(msgspec.structs.replace(new_cell(), site="Lab/1"))


async def test_query_without_payload_reads_json_also_by_wildcard() -> None:
    async def present(_: str, __: Empty) -> Snapshot:
        return snapshot(12)

    async with open_pair() as (router, _):
        router.serve("svc/snapshot", Empty, present)
        with plain_session(router.settings) as session:
            for selector in (f"{router.prefix}/svc/snapshot", f"{router.prefix}/**"):
                (reply,) = await asyncio.to_thread(lambda: list(session.get(selector)))  # noqa: B023
                sample = reply.result
                assert isinstance(sample, zenoh.Sample)
                assert str(sample.key_expr) == f"{router.prefix}/svc/snapshot"
                assert json.loads(sample.payload.to_bytes())["sequence"] == 12


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


async def test_requests_above_the_limit_are_refused_with_the_limit() -> None:
    async with open_pair() as (router, client):
        let = asyncio.Event()

        async def answer(_: str, request: DeviceRequest) -> DeviceReply:
            await let.wait()
            return DeviceReply(result={"method": request.method})

        router.serve("dev/robot/svc/read", DeviceRequest, answer)
        request = DeviceRequest(method="read")
        asked = [
            asyncio.ensure_future(client.request("dev/robot/svc/read", request, DeviceReply, TIMEOUT))
            for _ in range(ANSWERS + 5)
        ]
        async with asyncio.timeout(TIMEOUT):
            while sum(each.done() for each in asked) < 5:  # noqa: ASYNC110
                await asyncio.sleep(0.01)
        let.set()
        replies = await asyncio.gather(*asked, return_exceptions=True)
        refused = [each for each in replies if isinstance(each, DeviceError)]
        assert {(each.fields["reason"], str(ANSWERS) in each.text) for each in refused} == {("busy", True)}
        assert (len(refused), sum(isinstance(each, DeviceReply) for each in replies)) == (5, ANSWERS)
