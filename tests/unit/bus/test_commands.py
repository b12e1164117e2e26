"""Command edge: by hand in JSON, from programs in MessagePack, too many, and malformed."""

import asyncio
import json
import math
import time
from typing import Any

import msgpack
import pytest
import zenoh

from pcmrs.bus import CommandEdge
from pcmrs.bus.bridge import CAPACITY
from pcmrs.bus.codec import pack, unpack
from pcmrs.bus.commands import REPORTED_AT_ONCE, Envelope
from pcmrs.bus.keys import MAX_CHUNK
from pcmrs.errors import PayloadError
from pcmrs.messages import Command, Verdict
from pcmrs.messages.clipping import LONGEST_TEXT
from pcmrs.messages.identity import EVERY_CELL, Identity, Role
from tests.unit.bus.bus_cells import TIMEOUT, new_cell, open_bus, plain_session
from tests.unit.bus.edge_daemon import FLOOD, HELD_UP, PLAN, Daemon, get, running_daemon

LONG = "x" * 30_000
"""A name that its sender has chosen."""


REGISTER: dict[str, Role] = {"anna": "teleoperator", "eve": "viewer"}


async def test_a_json_query_by_hand_is_answered_in_json() -> None:
    async with running_daemon() as (daemon, session):
        payload = b' {"id": "a1", "sent": 5, "ttl": 2, "arguments": {"index": 3}}'
        verdict = json.loads(await get(daemon, session, PLAN, payload))
        assert verdict["decision"] == "accepted"
        assert verdict["id"] == "a1"
        command = daemon.submitted.get_nowait()
        assert command == Command(
            id="a1",
            source="bus:local",
            branch="registration",
            operation="plan_landmarks",
            arguments={"index": 3},
            sent=5.0,
            ttl=2.0,
        )


async def test_an_empty_query_is_no_arguments_and_gets_an_id() -> None:
    async with running_daemon() as (daemon, session):
        verdicts = [json.loads(await get(daemon, session, PLAN)) for _ in range(2)]
        assert verdicts[0]["id"] != verdicts[1]["id"]
        assert len(verdicts[0]["id"]) == 32
        assert daemon.submitted.get_nowait().arguments == {}


async def test_messagepack_is_answered_in_messagepack() -> None:
    async with running_daemon() as (daemon, session):
        verdict = unpack(await get(daemon, session, PLAN, pack(Envelope(id="b"))), Verdict)
        assert (verdict.id, verdict.decision, verdict.sequence) == ("b", "accepted", 7)


def registered(ends: float) -> list[Identity]:
    """Everyone of `REGISTER`, in every cell, until then."""
    return [
        Identity(name=name, role=role, serial="1", begins=0.0, ends=ends, cells=EVERY_CELL)
        for name, role in REGISTER.items()
    ]


async def test_user_has_the_registered_role_or_operator_if_no_register() -> None:
    """Without a register everybody counts as on site and has the role operator."""

    async def roles(names: tuple[str, ...], *members: Identity) -> list[tuple[str, str]]:
        async with running_daemon(*members) as (daemon, session):
            for name in names:
                await get(daemon, session, f"cmd/{name}/registration/reinit")
            commands = [daemon.submitted.get_nowait() for _ in names]
            return [(each.user, each.role) for each in commands]

    names = ("anna", "eve", "nobody", "local")
    assert await roles(names) == [(name, "operator") for name in names]
    known = registered(math.inf)
    assert await roles(("anna", "eve", "local"), *known) == [
        ("anna", "teleoperator"),
        ("eve", "viewer"),
        ("local", "operator"),
    ]


async def test_command_of_expired_or_unknown_user_is_refused_at_once() -> None:
    """It is refused before it reaches the dispatcher."""
    expired = registered(1.0)
    async with running_daemon(*expired) as (daemon, session):
        for name in ("anna", "nobody"):
            verdict = json.loads(await get(daemon, session, f"cmd/{name}/registration/reinit"))
            assert (verdict["decision"], verdict["reason"]["code"]) == ("rejected", "access_denied")
        assert daemon.submitted.empty()
        assert daemon.refused == [("bus:anna", "access_denied"), ("bus:nobody", "access_denied")]


@pytest.mark.parametrize("encoding", ["zenoh/bytes", "application/json", "text/plain"])
async def test_a_put_by_hand_is_submitted_whatever_its_encoding(encoding: str) -> None:
    async with running_daemon() as (daemon, session):
        session.put(f"{daemon.bus.prefix}/cmd/anna/toolplan/clear", b'{"id": "p"}', encoding=encoding)
        command = await asyncio.wait_for(daemon.submitted.get(), TIMEOUT)
        assert (command.id, command.source, command.branch) == ("p", "bus:anna", "toolplan")


@pytest.mark.parametrize(
    ("key", "payload", "says"),
    [
        (PLAN, b'{"id": "a", "argumnets": {}}', "argumnets"),
        (PLAN, b"plan it", "Neither MessagePack nor JSON"),
        (PLAN, b'{"arguments": {"x": NaN}}', "Neither MessagePack nor JSON"),
        (PLAN, b'{"arguments": {"x": "' + b"x" * 70000 + b'"}}', "at most 65536"),
        ("cmd/Local/registration/reinit", b"", "'Local' cannot be a part of a key"),
    ],
)
async def test_a_malformed_query_is_rejected_and_not_submitted(key: str, payload: bytes, says: str) -> None:
    async with running_daemon() as (daemon, session):
        verdict = unpack(await get(daemon, session, key, payload), Verdict)
        assert (verdict.decision, verdict.branch) == ("rejected", "registration")
        assert verdict.reason is not None
        assert verdict.reason.code == "malformed"
        assert daemon.refused == [(f"bus:{key.split('/')[1]}", "malformed")]
        assert says in verdict.reason.text
        assert daemon.submitted.empty()


@pytest.mark.parametrize(
    ("key", "payload"),
    [
        (f"cmd/eve/{LONG}/plan", b""),
        (f"cmd/eve/toolplan/{LONG}", b""),
        (f"cmd/{LONG}/toolplan/plan", b""),
        ("cmd/eve/toolplan/plan", json.dumps({LONG: 1}).encode()),
    ],
    ids=["branch", "operation", "user", "field"],
)
async def test_of_a_long_name_little_is_answered_or_reported(key: str, payload: bytes) -> None:
    async with running_daemon() as (daemon, session):
        events = session.declare_subscriber(f"{daemon.bus.prefix}/state/event")
        answers = [await get(daemon, session, key, payload)]
        session.put(f"{daemon.bus.prefix}/{key}", payload)
        event = await asyncio.wait_for(asyncio.to_thread(events.recv), TIMEOUT)
        for answer in (*answers, event.payload.to_bytes()):
            reason = unpack(answer, Verdict).reason
            assert reason is not None
            assert reason.code == "malformed"
            assert len(answer) < 2 * LONGEST_TEXT
        assert daemon.submitted.empty()
        assert len(daemon.refused) == len(daemon.texts) == 2
        assert max(map(len, daemon.texts)) < LONGEST_TEXT + 50
        assert max(len(source) for source, _ in daemon.refused) < 2 * MAX_CHUNK


async def test_a_malformed_put_is_refused_on_the_event_key() -> None:
    async with running_daemon() as (daemon, session):
        events = session.declare_subscriber(f"{daemon.bus.prefix}/state/event")
        await get(daemon, session, PLAN)
        daemon.submitted.get_nowait()
        session.put(f"{daemon.bus.prefix}/{PLAN}", b'{"arguments": 3}')
        event = await asyncio.wait_for(asyncio.to_thread(events.recv), TIMEOUT)
        verdict = unpack(event.payload.to_bytes(), Verdict)
        assert (verdict.decision, verdict.operation) == ("rejected", "plan_landmarks")
        assert daemon.refused == [("bus:local", "malformed")]
        assert daemon.submitted.empty()


async def test_looking_around_commands_nothing_and_stops_nothing() -> None:
    async with running_daemon() as (daemon, session):
        for selector in ("**", "cmd/local/*/reinit", "stop/*"):
            replies = await asyncio.to_thread(lambda: list(session.get(f"{daemon.bus.prefix}/{selector}")))  # noqa: B023
            assert [reply for reply in replies if reply.ok is not None] == []
        assert daemon.submitted.empty()
        assert daemon.stopped.empty()


async def test_too_many_commands_are_each_answered_busy() -> None:
    async with running_daemon() as (daemon, session):
        key, excess = f"{daemon.bus.prefix}/{PLAN}", 40
        asked = [session.get(key, payload=b'{"id": "%d"}' % number) for number in range(CAPACITY + excess)]
        # Until here the loop had no turn: the queue is full when the excess arrives.
        busy = await_busy(asked, excess)
        verdicts = await asyncio.to_thread(lambda: [verdict_of(replies) for replies in asked if replies not in busy])
        assert {verdict["decision"] for verdict in verdicts} == {"accepted"}
        assert daemon.submitted.qsize() == CAPACITY


async def test_too_many_puts_are_each_refused_busy_on_the_event_key() -> None:
    async with running_daemon() as (daemon, session):
        events = session.declare_subscriber(f"{daemon.bus.prefix}/state/event")
        await get(daemon, session, PLAN)
        daemon.submitted.get_nowait()
        key, excess = f"{daemon.bus.prefix}/{PLAN}", 40
        for number in range(CAPACITY + excess):
            payload = b'{"id": "%d"}' % number
            session.put(key, payload, congestion_control=zenoh.CongestionControl.BLOCK)
        # The loop has no turn until all refusals are here: they do not need it.
        refused = [unpack(events.recv().payload.to_bytes(), Verdict) for _ in range(excess)]
        assert {(verdict.decision, verdict.operation) for verdict in refused} == {("rejected", "plan_landmarks")}
        assert {verdict.reason.code for verdict in refused if verdict.reason is not None} == {"busy"}
        submitted = [(await asyncio.wait_for(daemon.submitted.get(), TIMEOUT)).id for _ in range(CAPACITY)]
        assert submitted == [str(number) for number in range(CAPACITY)]


async def test_of_very_many_refused_puts_most_are_only_counted() -> None:
    async with running_daemon() as (daemon, session):
        events: list[bytes] = []
        with plain_session(daemon.bus.settings) as watching:
            watching.declare_subscriber(
                f"{daemon.bus.prefix}/state/event", lambda event: events.append(event.payload.to_bytes())
            )
            await get(daemon, watching, PLAN)
            for _ in range(FLOOD):
                session.put(f"{daemon.bus.prefix}/{PLAN}", b"[", congestion_control=zenoh.CongestionControl.BLOCK)
            async with asyncio.timeout(TIMEOUT):
                while daemon.bus.counters()["bus.ignored"] < FLOOD - 2 * REPORTED_AT_ONCE:  # noqa: ASYNC110 - by threads
                    await asyncio.sleep(0.01)
            await get(daemon, watching, PLAN)
        assert 0 < len(events) < 2 * REPORTED_AT_ONCE


async def test_deeply_nested_envelope_is_refused_as_query_and_as_put() -> None:
    deep = b'{"id": "d", "arguments": {"a": ' + b"[" * 500 + b"]" * 500 + b"}}"
    async with running_daemon() as (daemon, session):
        events = session.declare_subscriber(f"{daemon.bus.prefix}/state/event")
        verdicts = [unpack(await get(daemon, session, PLAN, deep), Verdict)]
        session.put(f"{daemon.bus.prefix}/{PLAN}", deep)
        event = await asyncio.wait_for(asyncio.to_thread(events.recv), TIMEOUT)
        verdicts.append(unpack(event.payload.to_bytes(), Verdict))
        for verdict in verdicts:
            assert verdict.reason is not None
            assert verdict.reason.code == "malformed"
        assert daemon.submitted.empty()


def verdict_of(replies: Any) -> dict[str, Any]:
    return json.loads(next(iter(replies)).ok.payload.to_bytes())  # type: ignore[no-any-return]


def await_busy(asked: list[Any], excess: int) -> list[Any]:
    """Blocks the loop's thread until the last queries asked are answered: they are the ones refused."""
    refused = asked[-excess:]
    for replies in refused:
        verdict = verdict_of(replies)
        assert verdict["decision"] == "rejected"
        assert verdict["reason"]["code"] == "busy"
        assert str(CAPACITY) in verdict["reason"]["text"]
    return refused


async def test_a_closed_edge_takes_no_more_commands() -> None:
    async with open_bus(new_cell()) as bus:
        daemon = Daemon(bus)
        edge = await CommandEdge.open(bus, daemon.submit, daemon.refuse, daemon.stop)
        with plain_session(bus.settings) as session:
            await get(daemon, session, PLAN)
            daemon.submitted.get_nowait()
            await edge.close()
            session.put(f"{bus.prefix}/{PLAN}", b"")
            assert await asyncio.to_thread(lambda: list(session.get(f"{bus.prefix}/{PLAN}"))) == []
        assert daemon.submitted.empty()


async def test_command_age_counts_from_its_arrival_at_zenoh() -> None:
    """The age includes the time until the loop gets round to the command."""
    async with running_daemon() as (daemon, session):
        await get(daemon, session, PLAN)
        session.put(f"{daemon.bus.prefix}/{PLAN}", b"")
        reply = asyncio.ensure_future(get(daemon, session, PLAN))
        await asyncio.sleep(0)
        time.sleep(HELD_UP)  # noqa: ASYNC251 - the loop does something else, and two messages arrive
        await reply
        while len(daemon.ages) < 3:
            await daemon.submitted.get()
        assert min(daemon.ages[1:]) > HELD_UP / 2


@pytest.mark.parametrize(
    ("payload", "says"),
    [
        (b'{"id": "a", "argument": {}}', "unknown field `argument`"),
        (b'{"id": 5}', "Expected `str | null`, got `int`"),
        (b'{"id": ""}', "length >= 1"),
        (b'{"ttl": -1}', ">= 0"),
        (b'{"sent": 1e999}', "out of range"),
        (b'{"arguments": [1]}', "Expected `object`"),
        (b'{"arguments": {"x": 1}', "truncated"),
        (b'{"arguments": {"n": 9223372036854775808}}', "64 bits"),
        (b"plan the landmarks", "extra data"),
        (b"[1, 2]", "extra data"),
        (msgpack.packb({"arguments": {"x": [1.0, float("nan")]}}), "nan is not a finite number"),
        (msgpack.packb({"arguments": {"x": float("-inf")}}), "-inf is not a finite number"),
        (msgpack.packb({"arguments": {"x": msgpack.ExtType(4, b"?")}}), "ExtType"),
        (msgpack.packb({"arguments": {"x": msgpack.Timestamp(1)}}), "Timestamp"),
        (msgpack.packb({"arguments": {"x": {b"raw": 1}}}), "key that is not text"),
        (b"\xdd\xff\xff\xff\xff", "Neither MessagePack"),
        (b"\x91" * 5000 + b"\xc0", "StackError"),
        (b'{"arguments": {"a": ' + b"[" * 5000 + b"]" * 5000 + b"}}", "recursion"),
        (b'{"arguments": {"a": "' + b"x" * 65536 + b'"}}', "at most 65536"),
    ],
)
def test_a_malformed_envelope_is_refused_with_a_reason(payload: bytes, says: str) -> None:
    with pytest.raises(PayloadError) as refused:
        unpack(payload, Envelope)
    assert says.lower() in refused.value.text.lower()
