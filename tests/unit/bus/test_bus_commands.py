"""Command edge: by hand in JSON, from programs in MessagePack, too many, malformed, and Stop."""

import asyncio
import json
import math
import queue
import threading
import time
from collections import Counter
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from types import SimpleNamespace
from typing import Any

import pytest
import zenoh
from msgspec.structs import replace

from pcmrs.bus import Bus, CommandEdge, stop
from pcmrs.bus.bridge import CAPACITY
from pcmrs.bus.codec import pack, unpack
from pcmrs.bus.commands import REPORTED_AT_ONCE, Envelope
from pcmrs.bus.settings import STOPS
from pcmrs.bus.stop import LONGEST_PRESS, OTHERS, WAITING_ANSWERS, StopLane, Stopping, StopReplies
from pcmrs.messages import Command, Verdict
from pcmrs.messages.identity import Identity, Role
from tests.unit.bus.bus_cells import TIMEOUT, accepted, new_cell, open_bus, plain_session

REGISTER: dict[str, Role] = {"anna": "teleoperator", "eve": "viewer"}
HELD_UP = 1.0
"""The loop does something else for so long, s."""
FLOOD = 2_000
"""Presses of one who never stops pressing."""
PLAN = "cmd/local/registration/plan_landmarks"


class Daemon:
    """What stands behind the edge in these tests: it remembers, and accepts everything."""

    def __init__(self, bus: Bus) -> None:
        self.bus = bus
        self.submitted: asyncio.Queue[Command] = asyncio.Queue()
        self.stopped: asyncio.Queue[str] = asyncio.Queue()
        self.stops = 0
        self.presses: Counter[str] = Counter()
        self.ages: list[float] = []
        self.refused: list[tuple[str, str]] = []

    def refuse(self, source: str, code: str, text: str) -> None:
        self.refused.append((source, code))

    def stop(self, source: str, presses: int) -> int:
        """Numbers each Stop, from 1."""
        self.stopped.put_nowait(source)
        self.presses[source] += presses
        self.stops += 1
        return self.stops

    async def submit(self, command: Command, *, arrived: float) -> Verdict:
        self.submitted.put_nowait(command)
        self.ages.append(asyncio.get_running_loop().time() - arrived)
        return accepted(command)


@pytest.fixture
def many_links(monkeypatch: pytest.MonkeyPatch) -> None:
    """One link of a test is as many links together: it has no limit of Stops, of which one may follow at once."""
    monkeypatch.setattr("pcmrs.bus.settings.STOPS", {})


@asynccontextmanager
async def running_daemon(*members: Identity) -> AsyncIterator[tuple[Daemon, zenoh.Session]]:
    async with open_bus(replace(new_cell(), members=members)) as bus:
        daemon = Daemon(bus)
        edge = await CommandEdge.open(bus, daemon.submit, daemon.refuse, daemon.stop)
        try:
            with plain_session(bus.settings) as session:
                yield daemon, session
        finally:
            await edge.close()


async def get(daemon: Daemon, session: zenoh.Session, key: str, payload: bytes | None = None) -> bytes:
    replies = await asyncio.to_thread(lambda: list(session.get(f"{daemon.bus.prefix}/{key}", payload=payload)))
    (reply,) = replies
    return bytes(reply.result.payload.to_bytes())


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
    known = [Identity(name=name, role=role, serial="1", begins=0.0, ends=math.inf) for name, role in REGISTER.items()]
    assert await roles(("anna", "eve", "local"), *known) == [
        ("anna", "teleoperator"),
        ("eve", "viewer"),
        ("local", "operator"),
    ]


async def test_command_of_expired_or_unknown_user_is_refused_at_once() -> None:
    """It is refused before it reaches the dispatcher."""
    expired = [Identity(name=name, role=role, serial="1", begins=0.0, ends=1.0) for name, role in REGISTER.items()]
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


@pytest.mark.usefixtures("many_links")
async def test_a_press_is_one_stop_and_what_names_none_is_always_one() -> None:
    async with running_daemon() as (daemon, session):
        press = json.dumps({"id": "0123456789abcdef" * 2}).encode()

        async def number(user: str, payload: bytes) -> int:
            found: int = json.loads(await get(daemon, session, f"stop/{user}", payload))["number"]
            return found

        assert [await number("anna", press) for _ in range(3)] == [1, 1, 1]
        assert await number("bert", press) == 2  # nobody can take a Stop from somebody else by its id
        long = press.ljust(LONGEST_PRESS + 1)
        for payload in (b" {}", b' {"id": ""}', b' {"id": 3}', b' {"id": "pressed"}', press[:-1], long):
            before = daemon.stops
            assert [await number("anna", payload) for _ in range(2)] == [before + 1, before + 2]


def test_an_id_is_looked_for_in_a_short_message_only() -> None:
    """Reading long ones would hold up the Stops behind them: each of them is a Stop of its own, unread."""
    press = json.dumps({"id": "0123456789abcdef" * 2}).encode()
    for length in range(LONGEST_PRESS - 1, LONGEST_PRESS + 3):
        assert (stop._press_id(press.ljust(length)) is None) == (length > LONGEST_PRESS), length
    assert stop._press_id(b"") is None


@pytest.mark.parametrize("beside", [False, True])
async def test_a_stop_right_after_the_edge_is_open_is_not_lost(monkeypatch: pytest.MonkeyPatch, beside: bool) -> None:
    """The router learns of the lane later than the daemon has declared it; a device node's lane may be there before."""
    declare = zenoh.Session.declare_queryable
    late: list[threading.Timer] = []

    def declare_late(session: zenoh.Session, key: str, handler: Any, **more: Any) -> Any:
        if "/stop/" not in key:
            return declare(session, key, handler, **more)
        late.append(threading.Timer(0.2, declare, (session, key, handler)))
        late[-1].start()
        return SimpleNamespace(undeclare=late[-1].join)

    async with open_bus(new_cell()) as bus:
        daemon = Daemon(bus)
        node = await StopLane.open(bus.settings, lambda *_: None) if beside else None
        monkeypatch.setattr(zenoh.Session, "declare_queryable", declare_late)
        edge = await CommandEdge.open(bus, daemon.submit, daemon.refuse, daemon.stop)
        try:
            with plain_session(bus.settings) as session:
                await get(daemon, session, "stop/anna")
        finally:
            await edge.close()
            if node is not None:
                await node.close()
    assert daemon.stops == 1


@pytest.mark.usefixtures("many_links")
async def test_presses_are_forgotten_in_time(monkeypatch: pytest.MonkeyPatch) -> None:
    """Whoever sends the same id every time is stopped for, too."""
    monkeypatch.setattr("pcmrs.bus.stop.SAME_PRESS_TIME", 0.0)
    async with running_daemon() as (daemon, session):
        press = json.dumps({"id": "0123456789abcdef" * 2}).encode()
        for _ in range(2):
            await get(daemon, session, "stop/anna", press)
        assert daemon.stops == 2


@pytest.mark.usefixtures("many_links")
async def test_stop_by_put_and_by_query() -> None:
    async with running_daemon() as (daemon, session):
        session.put(f"{daemon.bus.prefix}/stop/anna", b"whatever")
        assert await asyncio.wait_for(daemon.stopped.get(), TIMEOUT) == "bus:anna"
        assert json.loads(await get(daemon, session, "stop/bert")) == {
            "source": "bus:bert",
            "number": 2,
            "stage": "begun",
        }
        assert daemon.stopped.get_nowait() == "bus:bert"
        reply = await get(daemon, session, "stop/carl", pack(Envelope()))
        assert unpack(reply, Stopping).source == "bus:carl"


@pytest.mark.usefixtures("many_links")
async def test_presses_of_a_source_are_bundled_and_do_not_delay_others() -> None:
    """The loop is notified once of all presses of a source that are waiting."""
    async with running_daemon() as (daemon, session):
        await get(daemon, session, "stop/anna")
        for _ in range(FLOOD):
            session.put(f"{daemon.bus.prefix}/stop/eve", b"", congestion_control=zenoh.CongestionControl.BLOCK)
        asked = asyncio.ensure_future(get(daemon, session, "stop/anna"))
        await asyncio.sleep(0)
        time.sleep(HELD_UP)  # noqa: ASYNC251 - the loop does something else meanwhile
        assert json.loads(await asked)["source"] == "bus:anna"
        async with asyncio.timeout(TIMEOUT):
            while daemon.presses["bus:eve"] < FLOOD:
                await daemon.stopped.get()
        assert daemon.presses == {"bus:anna": 2, "bus:eve": FLOOD}
        assert daemon.stops < FLOOD / 10


APART = 4 / STOPS["query"]
"""Zenoh drops what a link sends sooner after its last than the rate allows, s: who does not flood is slower."""


@pytest.mark.parametrize("names", [1, FLOOD])
async def test_flooding_link_gets_few_stops_through_and_another_all(names: int) -> None:
    async with running_daemon() as (daemon, session):
        prefix, pressed = daemon.bus.prefix, 0

        def flood() -> None:
            for number in range(10 * FLOOD):
                key = f"{prefix}/stop/eve{number % names}"
                session.put(key, b"", congestion_control=zenoh.CongestionControl.BLOCK)

        with plain_session(daemon.bus.settings) as other:
            await get(daemon, other, "stop/ben")  # the daemon knows the link: what comes sooner may be dropped
            flooding = asyncio.get_running_loop().run_in_executor(None, flood)
            while not flooding.done():
                assert len(await asyncio.to_thread(list, other.get(f"{prefix}/stop/anna"))) == 1
                pressed += 1
                await asyncio.sleep(APART)
            await flooding
            await get(daemon, other, "stop/ben")
        assert daemon.presses["bus:anna"] == pressed
        assert daemon.presses.total() < FLOOD


@pytest.mark.usefixtures("many_links")
async def test_stops_under_too_many_names_are_counted_together() -> None:
    async with running_daemon() as (daemon, session):
        await get(daemon, session, "stop/anna")
        for number in range(FLOOD):
            session.put(f"{daemon.bus.prefix}/stop/eve{number}", b"", congestion_control=zenoh.CongestionControl.BLOCK)
        time.sleep(HELD_UP)  # noqa: ASYNC251 - the loop does something else meanwhile
        async with asyncio.timeout(TIMEOUT):
            while daemon.presses.total() < FLOOD + 1:
                await daemon.stopped.get()
        assert daemon.presses[OTHERS] > FLOOD / 2


async def test_reply_behind_too_many_of_its_source_is_dropped(monkeypatch: pytest.MonkeyPatch) -> None:
    """The thread that sends them is slower than the loop: its link is full."""
    begun, gate, send = threading.Event(), threading.Event(), stop._reply

    def hold_up(*answer: Any) -> None:
        begun.set()
        gate.wait(TIMEOUT)
        send(*answer)

    monkeypatch.setattr(stop, "_reply", hold_up)
    queries: queue.Queue[zenoh.Query] = queue.Queue()
    replies = StopReplies()

    def add(source: str) -> None:
        replies.add(source, queries.get(timeout=TIMEOUT), Stopping(source=source, number=1))

    async with open_bus(new_cell()) as router:
        with plain_session(router.settings) as session:
            key = f"{router.prefix}/asked"
            session.declare_queryable(key, queries.put)
            asked = [session.get(key, timeout=TIMEOUT) for _ in range(WAITING_ANSWERS + 2)]
            await asyncio.to_thread(add, "bus:eve")
            assert await asyncio.to_thread(begun.wait, TIMEOUT), "this one is being sent: it does not wait any more"
            for _ in range(WAITING_ANSWERS + 1):
                await asyncio.to_thread(add, "bus:eve")
            other = session.get(key, timeout=TIMEOUT)
            await asyncio.to_thread(add, "bus:anna")
            gate.set()
            assert len(await asyncio.to_thread(list, other)) == 1
            answers = [len(await asyncio.to_thread(list, each)) for each in asked]
            assert sum(answers) == WAITING_ANSWERS + 1
            await asyncio.to_thread(replies.close)


@pytest.mark.usefixtures("many_links")
async def test_replies_to_one_source_are_limited_and_others_get_theirs() -> None:
    async with running_daemon() as (daemon, session):
        await get(daemon, session, "stop/anna")
        flood = [session.get(f"{daemon.bus.prefix}/stop/eve") for _ in range(4 * WAITING_ANSWERS)]
        asked = session.get(f"{daemon.bus.prefix}/stop/anna")
        time.sleep(HELD_UP)  # noqa: ASYNC251 - the loop does something else meanwhile
        assert len(await asyncio.to_thread(list, asked)) == 1
        answered = [len(await asyncio.to_thread(list, each)) for each in flood]
        assert WAITING_ANSWERS <= sum(answered) < 4 * WAITING_ANSWERS
        assert daemon.presses["bus:eve"] == 4 * WAITING_ANSWERS, "all are Stops"
