"""The simulated network: who hears what, in which order, and what becomes of requests when somebody is gone."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable

import msgspec
import pytest

from pcmrs.bus.bridge import ARRIVED
from pcmrs.errors import DeviceError, UnknownOutcomeError
from pcmrs.testing.loop import run_on_simulated_loop
from pcmrs_sim.deterministic.network import Endpoint, Network


class Note(msgspec.Struct, frozen=True):
    """A message."""

    number: int = 0


def on_network(play: Callable[[Network], Awaitable[None]], *, coded: bool = False) -> None:
    """Plays on a network of its own."""

    async def run() -> None:
        await play(Network(asyncio.get_running_loop(), 1, coded=coded))

    run_on_simulated_loop(run())


def heard_by(endpoint: Endpoint, key: str) -> list[int]:
    """What the endpoint will have heard."""
    heard: list[int] = []
    endpoint.subscribe(key, Note, lambda _, note: heard.append(note.number))
    return heard


@pytest.mark.parametrize("coded", [False, True])
def test_others_receive_in_order_and_senders_not_their_own(coded: bool) -> None:
    async def play(network: Network) -> None:
        one, other = network.endpoint("one"), network.endpoint("other")
        own, heard = heard_by(one, "state/*"), heard_by(other, "state/*")
        deaf = heard_by(other, "dev/*/beat")
        for number in range(100):
            one.publish("state/pose", Note(number))
            await asyncio.sleep(0.0001)
        await asyncio.sleep(1.0)
        assert (heard, own, deaf) == (list(range(100)), [], [])

    on_network(play, coded=coded)


def test_losses_duplicates_and_reordering_happen_and_end() -> None:
    async def play(network: Network) -> None:
        one, other = network.endpoint("one"), network.endpoint("other")
        heard = heard_by(other, "key")
        conditions = network.conditions
        conditions.loss, conditions.duplicates, conditions.reordering = 0.2, 0.2, 0.2
        for number in range(1000):
            one.publish("key", Note(number))
            await asyncio.sleep(0.001)
        await asyncio.sleep(1.0)
        assert 0 < 1000 - len(set(heard)) < 500
        assert len(heard) > len(set(heard))
        assert heard != sorted(heard)
        conditions.heal()
        heard.clear()
        one.publish("key", Note(1))
        await asyncio.sleep(1.0)
        assert heard == [1]

    on_network(play)


def test_a_partition_may_be_of_one_direction() -> None:
    async def play(network: Network) -> None:
        one, other = network.endpoint("one"), network.endpoint("other")
        there, back = heard_by(other, "key"), heard_by(one, "key")
        network.conditions.partition("one", "other", both=False)
        one.publish("key", Note(1))
        other.publish("key", Note(2))
        await asyncio.sleep(1.0)
        assert (there, back) == ([], [2])

    on_network(play)


def test_requests_are_answered_refused_or_unknown() -> None:
    async def play(network: Network) -> None:
        client, server = network.endpoint("client"), network.endpoint("server")

        async def answer(_key: str, note: Note) -> Note:
            if note.number < 0:
                raise DeviceError("no")
            await asyncio.sleep(float(note.number))
            return Note(note.number + 1)

        server.serve("ask", Note, answer)
        assert await client.request("ask", Note(1), Note, 5.0) == Note(2)
        with pytest.raises(DeviceError):
            await client.request("ask", Note(-1), Note, 5.0)
        with pytest.raises(UnknownOutcomeError, match="within 5 s"):
            await client.request("ask", Note(9), Note, 5.0)
        with pytest.raises(UnknownOutcomeError):
            await client.request("nobody", Note(), Note, 5.0)
        server.leave()
        await server.ended()

    on_network(play)


def test_request_after_its_key_was_ended_gets_no_answer() -> None:
    """A daemon that ends takes its services back while requests are on their way."""

    async def play(network: Network) -> None:
        one, other = network.endpoint("one"), network.endpoint("other")

        async def answer(_key: str, note: Note) -> Note:
            return note

        other.serve("cmd", Note, answer)
        request = asyncio.ensure_future(one.request("cmd", Note(), Note, timeout=60.0))
        await asyncio.sleep(0.0)
        other.end("cmd")
        with pytest.raises(UnknownOutcomeError, match="Nobody answers on cmd"):
            await request
        assert asyncio.get_running_loop().time() < 1.0, "at once, and not when the time for an answer has passed"

    on_network(play)


def test_end_of_a_process_is_known_at_once_and_ends_its_tasks() -> None:
    """Who has asked it learns of its end."""

    async def play(network: Network) -> None:
        client, server = network.endpoint("client"), network.endpoint("server")
        ended: list[str] = []

        async def answer(_key: str, _note: Note) -> Note:
            async def beside() -> None:
                try:
                    await asyncio.sleep(1000.0)
                finally:
                    ended.append("beside")

            task = asyncio.get_running_loop().create_task(beside())
            await asyncio.sleep(1000.0)
            await task
            return Note()

        server.serve("ask", Note, answer)
        asking = asyncio.get_running_loop().create_task(client.request("ask", Note(), Note, 500.0))
        await asyncio.sleep(1.0)
        server.leave()
        with pytest.raises(UnknownOutcomeError, match="has ended"):
            await asking
        await server.ended()
        assert ended == ["beside"]
        assert asyncio.get_running_loop().time() < 2.0

    on_network(play)


def test_requests_may_overtake_and_a_taken_one_is_still_sent() -> None:
    """As on the bus: a pool of threads sends them, and to cancel who asks does not recall what a thread has taken."""

    async def play(network: Network) -> None:
        client, server = network.endpoint("client"), network.endpoint("server")
        heard: list[int] = []

        async def answer(_key: str, note: Note) -> Note:
            heard.append(note.number)
            return note

        server.serve("slow", Note, answer)
        server.serve("quick", Note, answer)
        loop = asyncio.get_running_loop()
        slow = loop.create_task(client.request("slow", Note(1), Note, 5.0))
        assert await network.windows.reached("send:s*w", 0.3, 1.0)
        slow.cancel()
        assert await client.request("quick", Note(2), Note, 5.0) == Note(2)
        assert heard == [2]
        await asyncio.sleep(1.0)
        assert heard == [2, 1]

    on_network(play)


def test_delayed_process_receives_late_and_in_order() -> None:
    """The others continue."""

    async def play(network: Network) -> None:
        one, two, other = network.endpoint("one"), network.endpoint("two"), network.endpoint("other")
        late, now = heard_by(one, "key"), heard_by(two, "key")
        one.hold_up(0.4)
        for number in range(3):
            other.publish("key", Note(number))
            await asyncio.sleep(0.1)
        assert (late, now) == ([], [0, 1, 2])
        await asyncio.sleep(0.2)
        assert late == [0, 1, 2]

    on_network(play)


def test_a_request_arrives_while_its_process_is_delayed() -> None:
    """As on the bus: a thread receives it and stamps it, and the loop handles it later."""

    async def play(network: Network) -> None:
        client, server = network.endpoint("client"), network.endpoint("server")
        loop, stamps, seen = asyncio.get_running_loop(), list[tuple[float, float]](), list[tuple[str, float]]()
        network.on_request = lambda key, _, arrived: seen.append((key, arrived))

        async def answer(_key: str, note: Note) -> Note:
            stamps.append((ARRIVED.get(), loop.time()))
            return note

        server.serve("ask", Note, answer)
        server.hold_up(0.4)
        await client.request("ask", Note(), Note, 5.0)
        ((arrived, handled),) = stamps
        assert arrived < 0.1
        assert handled == pytest.approx(0.4)
        assert seen == [("ask", arrived)]

    on_network(play)
