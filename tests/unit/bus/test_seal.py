"""Daemon and device nodes take from each other what carries their seal, once, and nothing else."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from contextlib import AsyncExitStack, asynccontextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import msgspec
import pytest
import zenoh
from hypothesis import given
from hypothesis import strategies as st

from pcmrs.bus import Bus
from pcmrs.bus.codec import pack, unpack
from pcmrs.bus.seal import (
    LENGTH,
    SESSIONS,
    WINDOW,
    ReplayWindow,
    Seal,
    is_sealed,
    new_key,
    new_run,
    read_key,
    write_key,
)
from pcmrs.bus.serving import attached_to, payload_of
from pcmrs.errors import ConfigurationError, DeviceError, SealError, UnknownOutcomeError
from pcmrs.messages import Beat, DeviceEvent, DeviceHealth, DeviceReply, DeviceRequest
from tests.unit.bus.bus_cells import TIMEOUT, new_cell, open_bus, plain_session

KEY = "pcmrs/test/cell/dev/robot/event"


def fault(seal: Seal, mark: bytes, *args: Any) -> str:
    with pytest.raises(SealError) as caught:
        seal.check(mark, *args)
    return str(caught.value.fields["why"])


@given(payload=st.binary(max_size=64), flip=st.integers(0, LENGTH * 8 - 1))
def test_sealed_message_is_taken_once_and_never_if_a_bit_differs(payload: bytes, flip: int) -> None:
    key = new_key()
    run = key + new_run()
    sender, receiver, taken = Seal(run), Seal(run, daemon=True), ReplayWindow()
    mark = sender.put("put", KEY, payload)
    changed = bytearray(mark)
    changed[flip // 8] ^= 1 << flip % 8
    assert fault(receiver, bytes(changed), ("put",), KEY, payload, taken) == "forged"
    assert fault(receiver, mark, ("put",), KEY, payload + b"x", taken) == "forged"
    assert fault(receiver, mark, ("put",), KEY.replace("robot", "tracker"), payload, taken) == "forged"
    assert fault(receiver, mark, ("query",), KEY, payload, taken) == "forged"
    assert fault(Seal(new_key()), mark, ("put",), KEY, payload, taken) == "forged"
    assert fault(receiver, b"", ("put",), KEY, payload, taken) == "unsealed"
    assert receiver.check(mark, ("put",), KEY, payload, taken) == "put"
    assert fault(receiver, mark, ("put",), KEY, payload, taken) == "repeated"


def test_a_reply_answers_one_query_only() -> None:
    key = new_key()
    daemon, node = Seal(key), Seal(key)
    asked, other = (daemon.put("query", KEY, b"joints") for _ in range(2))
    taken = ReplayWindow()
    reply = node.put("reply", KEY, b"1", asked)
    assert fault(daemon, reply, ("reply", "error"), KEY, b"1", taken, other) == "forged"
    assert daemon.check(reply, ("reply", "error"), KEY, b"1", taken, asked) == "reply"


@given(order=st.permutations(range(1, 9)), far=st.integers(0, 3))
def test_within_the_window_messages_come_in_any_order_each_once(order: list[int], far: int) -> None:
    key = new_key()
    run = key + new_run()
    sender, receiver, taken = Seal(run), Seal(run, daemon=True), ReplayWindow()
    marks = {number: sender.put("put", KEY, b"") for number in range(1, 9)}
    for number in order:
        receiver.check(marks[number], ("put",), KEY, b"", taken)
    for mark in marks.values():
        assert fault(receiver, mark, ("put",), KEY, b"", taken) == "repeated"
    late, passed = sender.put("put", KEY, b""), [sender.put("put", KEY, b"") for _ in range(WINDOW - 2 + far)]
    receiver.check(passed[-1], ("put",), KEY, b"", taken)
    if far < 2:
        assert receiver.check(late, ("put",), KEY, b"", taken) == "put"
    else:
        assert fault(receiver, late, ("put",), KEY, b"", taken) == "repeated"


@pytest.mark.parametrize(
    ("key", "sealed"),
    [
        ("dev/robot/cmd", True),
        ("dev/tracker/beat", True),
        ("dev/scene/cmd", False),
        ("daemon/beat", True),
        ("state/joints", True),
        ("state/pose/coil", True),
        ("state/fsm", False),
        ("cmd/local/robot/connect", False),
        ("ros2/tracker/coil", False),
        ("stop/local", False),
    ],
)
def test_messages_between_daemon_and_nodes_are_sealed(key: str, sealed: bool) -> None:
    assert is_sealed(key) is sealed


def test_a_key_file_is_its_owners_alone_and_never_replaced(tmp_path: Path) -> None:
    path = tmp_path / "device.key"
    write_key(path)
    assert path.stat().st_mode & 0o777 == 0o600
    assert len(read_key(path)) == 32
    with pytest.raises(ConfigurationError, match="exists already"):
        write_key(path)
    path.chmod(0o640)
    with pytest.raises(ConfigurationError, match="0640"):
        read_key(path)
    path.chmod(0o600)
    path.write_text("short\n")
    with pytest.raises(ConfigurationError, match="64 hexadecimal digits"):
        read_key(path)
    with pytest.raises(ConfigurationError, match="cannot be read"):
        read_key(tmp_path / "none")


@dataclass
class Bench:
    """A daemon's bus, a node's, and a Zenoh client without the key."""

    daemon: Bus
    node: Bus
    stranger: zenoh.Session
    events: asyncio.Queue[DeviceEvent] = field(default_factory=asyncio.Queue)
    asked: list[str] = field(default_factory=list)

    def absolute(self, key: str) -> str:
        return f"{self.daemon.prefix}/{key}"

    async def request(self, method: str) -> Any:
        return (await self.daemon.request("dev/robot/cmd", DeviceRequest(method=method), DeviceReply, TIMEOUT)).result

    async def ready(self) -> None:
        """Until the router knows who serves the robot."""
        async with asyncio.timeout(TIMEOUT):
            while not self.asked:
                with suppress(UnknownOutcomeError):
                    await self.request("first")

    async def event(self) -> DeviceEvent:
        return await asyncio.wait_for(self.events.get(), TIMEOUT)

    async def not_sealed(self, bus: Bus, many: int) -> None:
        async with asyncio.timeout(TIMEOUT):
            while bus.counters()["bus.not_sealed"] < many:  # noqa: ASYNC110  counted in Zenoh's thread
                await asyncio.sleep(0.01)


@asynccontextmanager
async def opened() -> AsyncIterator[Bench]:
    settings, key = new_cell(), new_key()
    client = msgspec.structs.replace(settings, mode="client")
    async with (
        open_bus(settings, Seal(key + new_run(), daemon=True)) as daemon,
        open_bus(client, Seal(key)) as node,
    ):
        with plain_session(settings) as stranger:
            bench = Bench(daemon, node, stranger)
            daemon.subscribe("dev/*/event", DeviceEvent, lambda _, event: bench.events.put_nowait(event))

            async def answer(_key: str, request: DeviceRequest) -> DeviceReply:
                bench.asked.append(request.method)
                if request.method == "fail":
                    raise DeviceError("It does not.")
                return DeviceReply(result=request.method)

            node.serve("dev/robot/cmd", DeviceRequest, answer)
            await bench.ready()
            yield bench


async def test_unsealed_or_repeated_event_is_counted_and_dropped() -> None:
    """A sealed one that comes after it is delivered."""
    sealed: list[zenoh.Sample] = []
    async with opened() as bench:
        key = bench.absolute("dev/robot/event")
        bench.stranger.declare_subscriber(key, sealed.append)
        forged = pack(DeviceEvent(device="robot", code="forged", text="by nobody"))
        while not sealed:
            bench.node.publish("dev/robot/event", DeviceEvent(device="robot", code="true", text="by the node"))
            assert (await bench.event()).code == "true"
        bench.stranger.put(key, forged)
        bench.stranger.put(key, forged, attachment=bytes(LENGTH))
        own = sealed[0]
        assert own.attachment is not None
        bench.stranger.put(key, own.payload, attachment=own.attachment)
        await bench.not_sealed(bench.daemon, 3)
        bench.node.publish("dev/robot/event", DeviceEvent(device="robot", code="last", text="by the node"))
        assert (await bench.event()).code == "last"


async def test_an_unreadable_event_of_a_node_is_a_lost_event() -> None:
    """It may have been a danger; nobody without the key can cause this."""
    lost: asyncio.Queue[str] = asyncio.Queue()
    async with opened() as bench:
        bench.daemon.when_lost(lost.put_nowait)
        bench.stranger.put(bench.absolute("dev/tracker/event"), b"no event")
        await bench.not_sealed(bench.daemon, 1)
        while bench.events.empty():
            bench.node.publish("dev/robot/event", DeviceEvent(device="robot", code="known", text=""))
            await asyncio.sleep(0.01)
        bench.node.publish("dev/robot/event", {"no": "event"})
        assert await asyncio.wait_for(lost.get(), TIMEOUT) == "dev/robot/event"


async def test_unreadable_events_without_a_seal_are_no_lost_events() -> None:
    """Everybody may publish those of the scene, and what the daemon publishes for people."""
    lost: list[str] = []
    keys = ("dev/scene/event", "state/event")
    seen: asyncio.Queue[DeviceEvent] = asyncio.Queue()
    async with opened() as bench:
        bench.daemon.when_lost(lost.append)
        for key in keys:
            bench.daemon.subscribe(key, DeviceEvent, lambda _, event: seen.put_nowait(event))
        for key in keys:
            bench.stranger.put(bench.absolute(key), b"no event")
            bench.stranger.put(bench.absolute(key), pack(DeviceEvent(device="scene", code="last", text="")))
            assert (await asyncio.wait_for(seen.get(), TIMEOUT)).code == "last"
        assert bench.daemon.counters()["bus.ignored"] >= len(keys)
        await asyncio.sleep(0)
    assert lost == []


async def test_subscriber_without_a_key_reads_sealed_messages() -> None:
    read: asyncio.Queue[bytes] = asyncio.Queue()
    loop = asyncio.get_running_loop()
    async with opened() as bench:
        bench.stranger.declare_subscriber(
            bench.absolute("dev/robot/event"),
            lambda sample: loop.call_soon_threadsafe(read.put_nowait, sample.payload.to_bytes()),
        )
        while read.empty():
            bench.node.publish("dev/robot/event", DeviceEvent(device="robot", code="seen", text=""))
            await bench.event()
        assert b"seen" in await read.get()


async def test_unsealed_request_is_refused_before_the_device_sees_it() -> None:
    async with opened() as bench:
        asked, key = list(bench.asked), bench.absolute("dev/robot/cmd")
        request = pack(DeviceRequest(method="hold"))
        (reply,) = await asyncio.to_thread(lambda: list(bench.stranger.get(key, payload=request)))
        assert reply.err is not None
        assert unpack(reply.err.payload.to_bytes(), dict)["code"] == "not_sealed"
        assert bench.asked == asked


async def test_nobody_else_answers_for_a_device_or_takes_its_requests() -> None:
    async with opened() as bench:
        key = bench.absolute("dev/robot/cmd")
        intercepted: list[str] = []

        def forge(query: zenoh.Query) -> None:
            intercepted.append(str(query.key_expr))
            with query:
                query.reply(key, pack(DeviceReply(result="forged")), attachment=bytes(LENGTH))
                query.reply_err(b"{}")

        bench.stranger.declare_queryable(key, forge, complete=True)
        while not intercepted:
            assert await bench.request("joints") == "joints"
        assert await bench.request("joints") == "joints"
        assert bench.asked[-1] == "joints"
        await bench.not_sealed(bench.daemon, 1)


async def test_foreign_error_reply_is_counted_and_ends_no_request() -> None:
    """Zenoh's error replies can carry no seal."""
    async with opened() as bench:
        key = bench.absolute("dev/robot/cmd")
        told: list[str] = []

        def forge(query: zenoh.Query) -> None:
            told.append(str(query.key_expr))
            with query:
                query.reply_err(pack({"code": "device_failed", "text": "It does not.", "fields": {}}))

        bench.stranger.declare_queryable(key, forge, complete=True)
        async with asyncio.timeout(TIMEOUT):
            while not told:
                assert await bench.request("joints") == "joints"
        assert await bench.request("joints") == "joints"
        await bench.not_sealed(bench.daemon, 1)


async def test_listener_receives_only_sealed_messages() -> None:
    """Nobody else on the machine can speak for the daemon whose silence holds the robot."""
    beats: list[int] = []
    async with opened() as bench:
        bench.node.listen("daemon/beat", Beat, lambda _, beat: beats.append(beat.number))
        sealed: list[zenoh.Sample] = []
        bench.stranger.declare_subscriber(bench.absolute("daemon/beat"), sealed.append)
        async with asyncio.timeout(TIMEOUT):
            while not (beats and sealed):
                bench.daemon.publish("daemon/beat", Beat(number=1, session="a", alive=0.0, sent=0.0))
                await asyncio.sleep(0.01)
        forged = pack(Beat(number=2, session="a", alive=1.0, sent=1.0))
        own = sealed[0]
        assert own.attachment is not None
        key = bench.absolute("daemon/beat")
        bench.stranger.put(key, forged)
        bench.stranger.put(key, forged, attachment=bytes(LENGTH))
        bench.stranger.put(key, forged, attachment=own.attachment)
        bench.stranger.put(key, own.payload, attachment=own.attachment)
        await bench.not_sealed(bench.node, 4)
        taken = len(beats)
        async with asyncio.timeout(TIMEOUT):
            while 3 not in beats:
                bench.daemon.publish("daemon/beat", Beat(number=3, session="a", alive=0.0, sent=0.0))
                await asyncio.sleep(0.01)
        assert set(beats[:taken]) == {1}
        assert set(beats) == {1, 3}


async def test_failure_returns_sealed_and_other_key_is_unknown_outcome() -> None:
    async with opened() as bench:
        with pytest.raises(DeviceError, match="It does not"):
            await bench.request("fail")
        other = msgspec.structs.replace(bench.node.settings)
        asked = list(bench.asked)
        async with open_bus(other, Seal(new_key())) as stranger:
            with pytest.raises(UnknownOutcomeError):
                await stranger.request("dev/robot/cmd", DeviceRequest(method="hold"), DeviceReply, 5.0)
        assert bench.asked == asked


async def test_message_cached_for_late_subscribers_keeps_its_seal() -> None:
    heard: asyncio.Queue[DeviceHealth] = asyncio.Queue()
    async with opened() as bench:
        bench.node.publish("dev/robot/state", DeviceHealth(device="robot", connected=True))
        bench.node.publish("dev/robot/state", DeviceHealth(device="robot", connected=False, text="late"))
        bench.daemon.subscribe("dev/*/state", DeviceHealth, lambda _, health: heard.put_nowait(health))
        async with asyncio.timeout(TIMEOUT):
            while (await heard.get()).text != "late":
                pass
        assert bench.daemon.counters()["bus.not_sealed"] == 0


async def test_two_receivers_of_one_process_both_take_each_message() -> None:
    """The node hears the daemon's beats twice: in Zenoh's thread for the deadman, and in its loop."""
    in_thread: list[int] = []
    in_loop: list[int] = []
    async with opened() as bench:
        bench.node.listen("daemon/beat", Beat, lambda _, beat: in_thread.append(beat.number))
        bench.node.subscribe("daemon/beat", Beat, lambda _, beat: in_loop.append(beat.number))
        async with asyncio.timeout(TIMEOUT):
            number = 0
            while not (in_thread and in_loop):
                number += 1
                bench.daemon.publish("daemon/beat", Beat(number=number, session="a", alive=0.0, sent=0.0))
                await asyncio.sleep(0.01)
        assert bench.node.counters()["bus.not_sealed"] == 0


def test_sender_in_use_is_remembered_among_many_new_ones() -> None:
    """A daemon that runs for long sees many short-lived senders; the node that it has seen first still sends."""
    node, taken = bytes(8), ReplayWindow()
    assert taken.take(node, 1)
    for number in range(1, SESSIONS + 10):
        assert taken.take(number.to_bytes(8, "little"), 1)
        assert taken.take(node, number + 1)
    assert not taken.take(node, 1)
    assert not taken.take(node, SESSIONS)


def test_repetition_does_not_keep_a_sender_remembered() -> None:
    """Otherwise somebody without the key could choose which senders are forgotten."""
    silent, used, taken = bytes(8), b"\1" + bytes(7), ReplayWindow()
    assert taken.take(silent, 1)
    assert taken.take(used, 1)
    for number in range(2, SESSIONS):
        assert taken.take(number.to_bytes(8, "big"), 1)
    assert not taken.take(silent, 1)
    assert taken.take(b"\2" + bytes(7), 1)
    assert not taken.take(used, 1)


def introduce(daemon: Seal, node: Seal) -> None:
    """The node asks the daemon for its run."""
    question = node.put("question", KEY, b"")
    assert daemon.check(question, ("question",), KEY, b"", ReplayWindow()) == "question"
    answer = daemon.answer()
    reply = daemon.put("reply", KEY, answer, question)
    assert node.check(reply, ("reply",), KEY, answer, ReplayWindow(), question) == "reply"
    node.confirm(reply, answer)


def test_daemon_accepts_no_message_of_an_earlier_run() -> None:
    """With a key in a file, its earlier messages were recorded under the same key."""
    key = new_key()
    earlier, run = new_run(), new_run()
    daemon, node = Seal(key + run, daemon=True), Seal(key)
    taken = ReplayWindow()
    for sender in (node, Seal(key + earlier), Seal(key + new_run())):
        assert fault(daemon, sender.put("put", KEY, b""), ("put",), KEY, b"", taken) == "other_run"
    introduce(Seal(key + earlier, daemon=True), node)
    assert fault(daemon, node.put("put", KEY, b""), ("put",), KEY, b"", taken) == "other_run"
    introduce(daemon, node)
    assert daemon.check(node.put("put", KEY, b""), ("put",), KEY, b"", taken) == "put"
    assert daemon.check(Seal(key + run).put("put", KEY, b""), ("put",), KEY, b"", taken) == "put"
    assert fault(Seal(new_key() + run, daemon=True), daemon.put("put", KEY, b""), ("put",), KEY, b"", taken) == "forged"


@pytest.mark.parametrize("kind", ["put", "query"])
def test_node_accepts_nothing_before_the_run_is_confirmed(kind: Literal["put", "query"]) -> None:
    """Neither a node that gets the run with the key, nor one that names no run yet."""
    key, run = new_key(), new_run()
    daemon, taken = Seal(key + run, daemon=True), ReplayWindow()
    for node, sender in ((Seal(key + run), daemon), (Seal(key), daemon), (Seal(key), Seal(key))):
        assert fault(node, sender.put(kind, KEY, b""), (kind,), KEY, b"", taken) == "other_run"
    introduce(daemon, node)
    assert node.check(daemon.put(kind, KEY, b""), (kind,), KEY, b"", taken) == kind


def test_node_accepts_no_message_of_an_earlier_run() -> None:
    key = new_key()
    earlier, daemon, node = Seal(key + new_run(), daemon=True), Seal(key + new_run(), daemon=True), Seal(key)
    recorded = [earlier.put("put", KEY, b"") for _ in range(3)]
    introduce(earlier, node)
    assert node.check(earlier.put("put", KEY, b""), ("put",), KEY, b"", ReplayWindow()) == "put"
    introduce(daemon, node)
    recorded.append(earlier.put("put", KEY, b""))
    for each in recorded:
        assert fault(node, each, ("put",), KEY, b"", ReplayWindow()) == "other_run"


def test_new_node_accepts_no_earlier_message_of_the_present_run() -> None:
    """A node is restarted while the daemon goes on; a node that was there accepts what is still on its way."""
    key = new_key() + new_run()
    daemon, heart, old, new = Seal(key, daemon=True), Seal(key), Seal(key), Seal(key)
    introduce(daemon, old)
    recorded = [sender.put("put", KEY, b"") for sender in (daemon, heart, daemon, heart)]
    for each in reversed(recorded):
        daemon.count(each)
    introduce(daemon, new)
    introduce(daemon, old)
    for each in recorded:
        assert fault(new, each, ("put",), KEY, b"", ReplayWindow()) == "repeated"
        assert old.check(each, ("put",), KEY, b"", ReplayWindow()) == "put"
    for sender in (daemon, heart, Seal(key)):
        assert new.check(sender.put("put", KEY, b""), ("put",), KEY, b"", ReplayWindow()) == "put"


def test_a_recorded_answer_confirms_no_other_question() -> None:
    """Neither in place of a message, nor of a restarted node."""
    key = new_key()
    daemon, node, restarted = Seal(key + new_run(), daemon=True), Seal(key), Seal(key)
    questions = [each.put("question", KEY, b"") for each in (node, node, restarted)]
    answer = daemon.put("reply", KEY, b"", questions[0])
    for asker, question in ((node, questions[1]), (restarted, questions[2])):
        assert fault(asker, answer, ("reply",), KEY, b"", ReplayWindow(), question) == "forged"
    assert fault(daemon, questions[0], ("put", "query"), KEY, b"", ReplayWindow()) == "forged"


def test_processes_of_the_daemon_that_are_counted_are_limited() -> None:
    """The answer has a bounded size, and is about those that were last received."""
    key = new_key() + new_run()
    daemon, node, taken = Seal(key, daemon=True), Seal(key), ReplayWindow()
    first = Seal(key).put("put", KEY, b"")
    last = [Seal(key).put("put", KEY, b"") for _ in range(SESSIONS)]
    for each in (first, *last):
        daemon.count(each)
    introduce(daemon, node)
    assert all(fault(node, each, ("put",), KEY, b"", taken) == "repeated" for each in last)
    assert node.check(first, ("put",), KEY, b"", taken) == "put"


def test_reply_to_a_query_counts_whatever_run_it_names() -> None:
    """It is bound to the query."""
    key = new_key()
    daemon, node = Seal(key + new_run(), daemon=True), Seal(key)
    query = daemon.put("query", KEY, b"joints")
    assert daemon.check(node.put("reply", KEY, b"1", query), ("reply",), KEY, b"1", ReplayWindow(), query) == "reply"


@pytest.mark.parametrize("restarted", ["both", "node"])
async def test_a_restarted_node_takes_only_new_messages(restarted: str) -> None:
    """Somebody has recorded beats of the daemon and of its heart, and a request, and sends them again."""
    settings, key = new_cell(), new_key()
    client = msgspec.structs.replace(settings, mode="client")
    recorded: list[tuple[bytes, Any]] = []
    request: list[tuple[bytes, bytes]] = []
    beats: list[str] = []
    asked: list[str] = []

    async def answer(_key: str, sent: DeviceRequest) -> DeviceReply:
        asked.append(sent.method)
        return DeviceReply(result=sent.method)

    async with AsyncExitStack() as daemon_stack, AsyncExitStack() as node_stack:

        async def start_daemon() -> tuple[Bus, Bus]:
            run = key + new_run()
            daemon = await daemon_stack.enter_async_context(open_bus(settings, Seal(run, daemon=True)))
            daemon.subscribe("daemon/beat", Beat, lambda _key, _beat: None)
            return daemon, await daemon_stack.enter_async_context(open_bus(client, Seal(run)))

        async def start_node() -> Bus:
            node = await node_stack.enter_async_context(open_bus(client, Seal(key)))
            node.listen("daemon/beat", Beat, lambda _, beat: beats.append(beat.session))
            node.serve("dev/robot/cmd", DeviceRequest, answer)
            return node

        async def until_received(daemon: Bus, heart: Bus, name: str) -> None:
            """Publishes beats and sends requests until the node has received one of each."""
            async with asyncio.timeout(TIMEOUT):
                while not {name, f"{name} heart"} <= {*beats} or name not in asked:
                    daemon.publish("daemon/beat", Beat(number=1, session=name, alive=0.0, sent=0.0))
                    heart.publish("daemon/beat", Beat(number=1, session=f"{name} heart", alive=0.0, sent=0.0))
                    with suppress(UnknownOutcomeError):
                        await daemon.request("dev/robot/cmd", DeviceRequest(method=name), DeviceReply, TIMEOUT)

        def record(query: zenoh.Query) -> None:
            with query:
                request.append((payload_of(query), attached_to(query)))

        daemon, heart = await start_daemon()
        await start_node()
        with plain_session(settings) as stranger:
            stranger.declare_subscriber(
                f"{daemon.prefix}/daemon/beat",
                lambda sample: recorded.append((payload_of(sample), attached_to(sample))),
            )
            stranger.declare_queryable(f"{daemon.prefix}/dev/robot/cmd", record, complete=True)
            async with asyncio.timeout(TIMEOUT):
                while not (recorded and request):
                    beats.clear()
                    asked.clear()
                    await until_received(daemon, heart, "old")
            await until_received(daemon, heart, "old")
        await node_stack.aclose()
        if restarted == "both":
            await daemon_stack.aclose()
            daemon, heart = await start_daemon()
        beats.clear()
        asked.clear()
        node = await start_node()
        await until_received(daemon, heart, "new")
        with plain_session(settings) as stranger:

            def ask_again(payload: bytes, seal: bytes) -> list[bytes]:
                replies = stranger.get(f"{daemon.prefix}/dev/robot/cmd", payload=payload, attachment=seal)
                return [each.err.payload.to_bytes() if each.err is not None else b"accepted" for each in replies]

            async with asyncio.timeout(TIMEOUT):
                while node.counters()["bus.not_sealed"] < len(recorded):
                    for payload, seal in recorded:
                        stranger.put(f"{daemon.prefix}/daemon/beat", payload, attachment=seal)
                    await asyncio.sleep(0.02)
            for payload, seal in request:
                replies = await asyncio.to_thread(ask_again, payload, seal)
                assert [unpack(each, dict)["code"] for each in replies] == ["not_sealed"]
        beats.append("replayed")
        asked.append("replayed")
        await until_received(daemon, heart, "last")
        assert {*beats} == {"new", "new heart", "replayed", "last", "last heart"}
        assert {*asked} == {"new", "replayed", "last"}


async def test_a_restarted_daemon_takes_only_new_messages_of_a_node() -> None:
    """The node, on another machine, continues; somebody who has recorded its messages sends them again."""
    settings, key = new_cell(), new_key()
    client = msgspec.structs.replace(settings, mode="client")
    recorded: list[zenoh.Sample] = []
    seen: list[str] = []

    @asynccontextmanager
    async def daemon() -> AsyncIterator[Bus]:
        """A daemon that keeps the events that it accepts."""
        seen.clear()
        async with open_bus(settings, Seal(key + new_run(), daemon=True)) as bus:
            bus.subscribe("dev/*/event", DeviceEvent, lambda _, event: seen.append(event.code))
            yield bus

    async def until_seen(bus: Bus, node: Bus, code: str) -> None:
        """Publishes events until the daemon accepts one."""
        async with asyncio.timeout(TIMEOUT):
            while code not in seen:
                node.publish("dev/robot/event", DeviceEvent(device="robot", code=code, text=""))
                await asyncio.sleep(0.02)

    async with daemon() as first, open_bus(client, Seal(key)) as node:
        with plain_session(settings) as stranger:
            stranger.declare_subscriber(f"{first.prefix}/dev/robot/event", recorded.append)
            async with asyncio.timeout(TIMEOUT):
                while not recorded:
                    seen.clear()
                    await until_seen(first, node, "old")
    old = recorded[-1]
    assert old.attachment is not None
    async with daemon() as second, open_bus(client, Seal(key)) as node:
        await until_seen(second, node, "new")
        before = second.counters()["bus.not_sealed"]
        with plain_session(settings) as stranger:
            async with asyncio.timeout(TIMEOUT):
                while second.counters()["bus.not_sealed"] == before:
                    stranger.put(f"{second.prefix}/dev/robot/event", old.payload, attachment=old.attachment)
                    await asyncio.sleep(0.02)
        await until_seen(second, node, "last")
        assert set(seen) == {"new", "last"}
