"""Publishers and subscribers: late ones get what is kept, and none its own messages."""

import asyncio
import queue
from typing import Any

import zenoh

from pcmrs.bus import BusSettings
from pcmrs.bus.declare import declare_publisher, declare_subscriber
from pcmrs.bus.qos import EPOCHS, POSES, SNAPSHOTS
from pcmrs.bus.serving import payload_of
from pcmrs.messages import BodyPose, Snapshot
from tests.unit.bus.bus_cells import TIMEOUT, open_pair, plain_session, pose, snapshot

KINDS = {"snapshots": SNAPSHOTS, "epochs": EPOCHS, "poses": POSES}


async def test_a_late_joiner_gets_the_last_snapshot() -> None:
    async with open_pair() as (router, client):
        for sequence in range(5):
            router.publish("state/fsm", snapshot(sequence))
        received: asyncio.Queue[Snapshot] = asyncio.Queue()
        client.subscribe("state/fsm", Snapshot, lambda _, message: received.put_nowait(message))
        assert (await asyncio.wait_for(received.get(), TIMEOUT)).sequence == 4


async def test_a_process_does_not_hear_itself() -> None:
    async with open_pair() as (router, client):
        received: asyncio.Queue[int] = asyncio.Queue()
        router.subscribe("dev/robot/beat", BodyPose, lambda _, message: received.put_nowait(message.frame_number))
        router.publish("dev/robot/beat", pose(1))
        client.publish("dev/robot/beat", pose(2))
        assert await asyncio.wait_for(received.get(), TIMEOUT) == 2


async def publish_past_the_router(publishers: dict[str, Any], settings: BusSettings) -> int:
    """Publish numbers, and return the last one when all have passed the router.

    A number that is still on its way would reach a subscriber that comes later as a new message.
    """
    passed: dict[str, int] = {}

    def receive(sample: zenoh.Sample) -> None:
        passed[str(sample.key_expr).removeprefix("k/")] = int(payload_of(sample))

    with plain_session(settings) as watching:
        subscriber = watching.declare_subscriber("k/*", receive)
        number = 0
        async with asyncio.timeout(TIMEOUT):
            # The first ones may be sent before the publishers know of a subscriber.
            while number < 9 or passed != dict.fromkeys(publishers, number):
                number += 1
                for publisher in publishers.values():
                    publisher.put(b"%d" % number)
                await asyncio.sleep(0.05)
        subscriber.undeclare()  # type: ignore[no-untyped-call]
    return number


async def test_late_subscribers_get_the_history_of_their_class_of_data() -> None:
    """A stream without history begins with a message after the subscription."""
    async with open_pair() as (router, _):
        with plain_session(router.settings) as session, plain_session(router.settings) as late:
            publishers = {name: declare_publisher(session, f"k/{name}", data) for name, data in KINDS.items()}
            last = await publish_past_the_router(publishers, router.settings)
            received: dict[str, queue.Queue[bytes]] = {name: queue.Queue() for name in KINDS}

            def receive(sample: zenoh.Sample) -> None:
                received[str(sample.key_expr).removeprefix("k/")].put(payload_of(sample))

            subscribers = [declare_subscriber(late, f"k/{name}", data, receive) for name, data in KINDS.items()]
            assert [received["epochs"].get(timeout=TIMEOUT) for _ in range(5)] == [
                b"%d" % n for n in range(last - 4, last + 1)
            ]
            assert received["snapshots"].get(timeout=TIMEOUT) == b"%d" % last
            async with asyncio.timeout(TIMEOUT):
                while received["poses"].empty():
                    publishers["poses"].put(b"live")
                    await asyncio.sleep(0.02)
            assert received["poses"].get() == b"live"
            for each in subscribers:
                each.undeclare()
