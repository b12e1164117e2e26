"""Devices of a world in another process, as its node sees them; the world is a script here."""

from __future__ import annotations

import asyncio
import socket
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager

import msgspec
import pytest

from pcmrs.clock import SystemClock
from pcmrs.errors import ConfigurationError, DeviceError, UnknownOutcomeError
from pcmrs.messages import DeviceEvent, JointState
from pcmrs_sim.process.channel import Channel
from pcmrs_sim.process.client import WorldClient, devices_of
from pcmrs_sim.process.wire import (
    Alive,
    ArmState,
    Call,
    Cancel,
    Failure,
    Open,
    Opened,
    Reply,
    ToNode,
    ToWorld,
    Trouble,
    WorldEvent,
    pack,
    read_by_world,
)

CLOCK = SystemClock()
PATIENCE = 10.0  # s
STATE = JointState(captured=1.0, sent=1.0, positions=[0.5] * 7, velocities=[0.0] * 7, torques=[0.0] * 7, moving=False)


class ScriptedWorld:
    """The other end of the link: what it received, and what it says."""

    def __init__(self, link: socket.socket) -> None:
        self.received: asyncio.Queue[ToWorld] = asyncio.Queue()
        self.channel = Channel(link, lambda body: self.received.put_nowait(read_by_world(body)), lambda: None)

    def say(self, message: ToNode) -> None:
        self.channel.send(pack(message))

    async def next_call(self) -> Call:
        async with asyncio.timeout(PATIENCE):
            message = await self.received.get()
        assert isinstance(message, Call)
        return message


@asynccontextmanager
async def linked(lost: Callable[[], object] = lambda: None) -> AsyncIterator[tuple[WorldClient, ScriptedWorld]]:
    here, there = socket.socketpair()
    world, client = ScriptedWorld(there), WorldClient(here, CLOCK, lost)
    try:
        opening = asyncio.create_task(client.open(["robot"], {"sim": {"seed": 3}}))
        async with asyncio.timeout(PATIENCE):
            assert await world.received.get() == Open(["robot"], {"sim": {"seed": 3}})
            world.say(Opened())
            await opening
            yield client, world
    finally:
        client.close()
        world.channel.close()


async def test_a_call_is_sent_by_name_and_its_result_is_typed() -> None:
    async with linked() as (client, world):
        robot = devices_of(client, ("robot",), CLOCK)["robot"]
        calling = asyncio.create_task(robot.end_servo(4))
        call = await world.next_call()
        assert (call.device, call.method, call.arguments) == ("robot", "end_servo", {"session": 4})
        world.say(Reply(call.number, {"outcome": "stopped", "positions": [0.0] * 7, "reason": "held"}))
        assert (await calling).reason == "held"


async def test_replies_in_another_order_reach_their_callers() -> None:
    async with linked() as (client, world):
        robot = devices_of(client, ("robot",), CLOCK)["robot"]
        first, second = asyncio.create_task(robot.joints()), asyncio.create_task(robot.joints())
        calls = [await world.next_call() for _ in range(2)]
        for call, captured in ((calls[1], 2.0), (calls[0], 1.0)):
            world.say(Reply(call.number, msgspec.to_builtins(msgspec.structs.replace(STATE, captured=captured))))
        assert [(await first).captured, (await second).captured] == [1.0, 2.0]


async def test_a_failed_call_raises_the_error_of_the_device() -> None:
    async with linked() as (client, world):
        robot = devices_of(client, ("robot",), CLOCK)["robot"]
        calling = asyncio.create_task(robot.hold())
        call = await world.next_call()
        world.say(Reply(call.number, failure=Failure.of(DeviceError("The arm is hot.", limit=40.0))))
        with pytest.raises(DeviceError, match="is hot") as refused:
            await calling
        assert refused.value.fields == {"limit": 40.0}


async def test_a_cancelled_call_is_cancelled_in_the_world() -> None:
    async with linked() as (client, world):
        robot = devices_of(client, ("robot",), CLOCK)["robot"]
        calling = asyncio.create_task(robot.hold())
        call = await world.next_call()
        calling.cancel()
        assert await world.received.get() == Cancel(call.number)
        world.say(Reply(call.number, msgspec.to_builtins(STATE)))  # too late for anyone
        with pytest.raises(asyncio.CancelledError):
            await calling


async def test_states_events_and_troubles_are_those_of_their_device() -> None:
    async with linked() as (client, world):
        robot, tracker = devices_of(client, ("robot", "tracker"), CLOCK).values()
        states, events = asyncio.ensure_future(anext(robot.states())), asyncio.ensure_future(anext(robot.events()))
        await asyncio.sleep(0)
        event = DeviceEvent(device="robot", code="drives_off", text="Off.", danger=True)
        world.say(Trouble("tracker", "switched off"))
        world.say(ArmState(STATE, dropped=3))
        world.say(WorldEvent(event))
        assert (await states, await events) == (STATE, event)
        assert (robot.dropped, robot.trouble, tracker.trouble) == (3, "", "switched off")


async def test_end_of_the_world_is_an_unknown_outcome_and_ends_streams() -> None:
    reports: list[str] = []
    async with linked(lambda: reports.append("lost")) as (client, world):
        robot = devices_of(client, ("robot",), CLOCK)["robot"]
        calling, reading = asyncio.create_task(robot.hold()), asyncio.ensure_future(anext(robot.states(), None))
        await world.next_call()
        world.channel.close()
        with pytest.raises(UnknownOutcomeError, match="has ended"):
            await calling
        assert await reading is None
        assert (client.is_lost, reports) == (True, ["lost"])
        with pytest.raises(UnknownOutcomeError, match="has ended"):
            await robot.joints()


async def test_settings_that_the_world_refuses_are_an_error_of_opening() -> None:
    here, there = socket.socketpair()
    world, client = ScriptedWorld(there), WorldClient(here, CLOCK, lambda: None)
    opening = asyncio.create_task(client.open(["robot"], {}))
    await asyncio.sleep(0)
    world.say(Opened(Failure.of(ConfigurationError("There is no arm puma560."))))
    with pytest.raises(ConfigurationError, match="puma560"):
        await opening
    client.close()
    world.channel.close()


async def test_a_method_that_the_device_does_not_have_is_no_call() -> None:
    async with linked() as (client, world):
        with pytest.raises(AttributeError, match="A robot has no method 'fire'"):
            devices_of(client, ("robot",), CLOCK)["robot"].fire(1)
        assert world.received.empty()


async def test_heartbeats_are_numbered_and_come_within_the_deadman() -> None:
    async with linked() as (client, world):
        beating = asyncio.create_task(client.beat(0.2))
        start = CLOCK.monotonic()
        beats = [await world.received.get() for _ in range(3)]
        beating.cancel()
        assert [beat.beat.number for beat in beats if isinstance(beat, Alive)] == [1, 2, 3]
        assert all(start <= beat.beat.sent <= CLOCK.monotonic() for beat in beats if isinstance(beat, Alive))
        with pytest.raises(asyncio.CancelledError):
            await beating
