"""Commands are as old as they are, although the loop was held up and has read them late."""

from __future__ import annotations

import asyncio
import socket
import time
from collections.abc import Awaitable, Callable
from pathlib import Path

import pytest
import uvloop

from pcmrs.background import BackgroundTasks
from pcmrs.clock import SystemClock
from pcmrs.gateway._arrival import ReceiveWatch
from pcmrs.gateway.links import open_gateway
from pcmrs.gateway.peer_session import BEGIN_WITHIN
from pcmrs.gateway.settings import GatewayConfig, LinkConfig
from pcmrs.testing.clock import SetClock
from tests.unit.gateway.gateway_fakes import WITHIN, FakeCore

CONFIG = GatewayConfig(
    planner=LinkConfig(port=0), robot=LinkConfig(), visualization=LinkConfig(), mep=LinkConfig(), tcp_port=0
)
MOTION = b"execute_motionxx_#91;"
OTHER = b"get_jnt_angsxxxx_#82;"
EXPIRED = b"91_rejected_placement_retracted_expired;"

in_each_loop = pytest.mark.parametrize(
    "new_loop", [asyncio.new_event_loop, uvloop.new_event_loop], ids=["asyncio", "uvloop"]
)
NewLoop = Callable[[], asyncio.AbstractEventLoop]
Opened = Callable[[str], socket.socket]


def run(new_loop: NewLoop, folder: Path, scenario: Callable[[Opened], Awaitable[None]]) -> FakeCore:
    """Run a scenario with a gateway in real time; its sockets work without the loop."""
    core, sockets = FakeCore(), list[socket.socket]()

    async def serve() -> None:
        async with open_gateway(core, CONFIG, SystemClock(), folder) as gateway:

            def opened(link: str) -> socket.socket:
                if link == "tcp":
                    end = socket.create_connection(gateway.addresses[link])
                else:
                    end = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
                    end.connect(gateway.addresses[link])
                end.setblocking(False)
                sockets.append(end)
                return end

            await scenario(opened)
        for each in sockets:
            each.close()

    with asyncio.Runner(loop_factory=new_loop) as runner:
        runner.run(serve())
    return core


def hold_up_the_loop() -> None:
    """This is its thread."""
    time.sleep(3 * BEGIN_WITHIN)


async def answers(end: socket.socket, last: bytes) -> bytes:
    """What comes, up to and with an answer that begins in this way."""
    received = b""
    async with asyncio.timeout(WITHIN):
        while last not in received or not received.endswith(b";"):
            received += await asyncio.get_running_loop().sock_recv(end, 65536)
    return received


async def is_soon_accepted(end: socket.socket) -> bool:
    """On a busy machine a motion may really come too late."""
    for number in range(100, 200):
        end.send(b"execute_motionxx_#%d;" % number)
        if b"_accepted_" in await answers(end, b"%d_" % number):
            return True
    return False


@in_each_loop
@pytest.mark.parametrize("link", ["planner", "tcp"])
@pytest.mark.parametrize("others", [0, 60])
def test_motion_that_waited_while_the_loop_was_held_up_is_late(
    new_loop: NewLoop, link: str, others: int, tmp_path: Path
) -> None:
    """Also behind so many commands that it is not read in the first turn of the loop."""

    async def scenario(opened: Opened) -> None:
        end = opened(link)
        end.send(OTHER)
        await answers(end, b"82_")  # the loop serves it, and has nothing more to read
        for _ in range(others):
            end.send(OTHER)
        end.send(MOTION)
        hold_up_the_loop()
        assert EXPIRED in await answers(end, b"91_")
        assert await is_soon_accepted(end)

    assert run(new_loop, tmp_path, scenario).operations == ["approach"]


@in_each_loop
def test_motion_over_a_connection_not_yet_accepted_is_late(new_loop: NewLoop, tmp_path: Path) -> None:
    async def scenario(opened: Opened) -> None:
        first = opened("tcp")
        first.send(OTHER)
        await answers(first, b"82_")
        end = opened("tcp")
        end.send(MOTION)
        hold_up_the_loop()
        assert await answers(end, b"91_") == EXPIRED
        assert await is_soon_accepted(end)

    assert run(new_loop, tmp_path, scenario).operations == ["approach"]


def test_a_part_of_a_command_that_was_read_does_not_make_it_old(tmp_path: Path) -> None:
    async def scenario(opened: Opened) -> None:
        end = opened("tcp")
        end.send(OTHER + MOTION[:8])
        await answers(end, b"82_")
        await asyncio.sleep(3 * BEGIN_WITHIN)  # the command arrives with its last byte
        end.send(MOTION[8:])
        answer = await answers(end, b"91_")
        assert answer.startswith(b"91_accepted") or await is_soon_accepted(end)

    run(asyncio.new_event_loop, tmp_path, scenario)


def test_a_client_that_sends_all_the_time_is_soon_in_time(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """At every look there may be something to read, as if there were no looks."""
    monkeypatch.setattr(ReceiveWatch, "start", lambda _: None)

    async def scenario(opened: Opened) -> None:
        end = opened("tcp")
        await asyncio.sleep(3 * BEGIN_WITHIN)
        assert await is_soon_accepted(end)

    run(asyncio.new_event_loop, tmp_path, scenario)


class Pair:
    """A watched socket, and what it receives."""

    def __init__(self, clock: SystemClock) -> None:
        self.watch = ReceiveWatch(clock, BackgroundTasks())
        self.queue = self.watch.new_queue()
        self.end = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.end.bind(("127.0.0.1", 0))
        self.watch.add_stamped(self.queue, self.end.fileno())

    def send(self) -> None:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
            other.sendto(OTHER, self.end.getsockname())


def test_a_queue_counts_as_empty_only_when_all_is_taken() -> None:
    pair = Pair(SystemClock())
    pair.watch.look()
    since = pair.queue.since
    pair.send()
    pair.watch.look()
    assert pair.queue.since == since, "something is waiting"
    pair.end.recv(4096)
    pair.queue.buffered = 1
    pair.watch.look()
    assert pair.queue.since == since, "something is read and not taken"
    pair.queue.buffered = 0
    pair.watch.look()
    assert (pair.queue.before, pair.queue.since > since) == (since, True)
    pair.watch.remove(pair.queue)
    pair.watch.look()
    pair.end.close()


def test_stamp_of_the_kernel_counts_unless_its_clock_was_set() -> None:
    clock = SetClock()
    pair = Pair(clock)
    pair.watch.look()
    pair.send()
    pair.end.recv(4096)
    assert pair.queue.since < pair.watch.arrival(pair.queue) <= clock.monotonic()
    for clock.ahead in (-3600.0, 3600.0):
        assert pair.watch.arrival(pair.queue) == pair.queue.since
    pair.watch.remove(pair.queue)
    pair.end.close()
