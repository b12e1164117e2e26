"""The lane of Stop: which messages are one press, floods, and answers."""

import asyncio
import json
import queue
import threading
import time
from types import SimpleNamespace
from typing import Any

import pytest
import zenoh

from pcmrs.bus import CommandEdge, stop
from pcmrs.bus.codec import pack, unpack
from pcmrs.bus.commands import Envelope
from pcmrs.bus.keys import MAX_CHUNK
from pcmrs.bus.settings import STOPS
from pcmrs.bus.stop import LONGEST_PRESS, OTHERS, WAITING_ANSWERS, StopLane, Stopping, StopReplies
from tests.unit.bus.bus_cells import TIMEOUT, new_cell, open_bus, plain_session
from tests.unit.bus.edge_daemon import FLOOD, HELD_UP, Daemon, get, running_daemon


@pytest.fixture
def many_links(monkeypatch: pytest.MonkeyPatch) -> None:
    """One link of a test is as many links together: it has no limit of Stops, of which one may follow at once."""
    monkeypatch.setattr("pcmrs.bus.settings.STOPS", {})


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


@pytest.mark.usefixtures("many_links")
async def test_every_name_stops_and_a_long_one_is_shortened() -> None:
    """The row of a Stop holds its source."""
    async with running_daemon() as (daemon, session):
        answer = json.loads(await get(daemon, session, f"stop/{'x' * 30_000}"))
        assert answer["number"] == daemon.stops == 1
        source = daemon.stopped.get_nowait()
        assert source.startswith(f"bus:{'x' * MAX_CHUNK}…")
        assert len(source) < 2 * MAX_CHUNK
