"""The world's end of the link: answers a node, sends what the devices measure, and watches that the node is there."""

from __future__ import annotations

import asyncio
import socket
from collections.abc import AsyncIterator, Callable, Collection, Coroutine, Iterator
from typing import Any, TypeVar

import structlog

from pcmrs.clock import SystemClock
from pcmrs.devices.calls import call_method
from pcmrs.devices.deadman import DEADMAN, Deadman, Silence
from pcmrs.devices.gate import ACTS, HOLDS
from pcmrs.errors import DeviceError, PcmrsError, UnknownOutcomeError
from pcmrs.threads import keep_pauses_short
from pcmrs_sim.cell import CellSimulation
from pcmrs_sim.opening import open_cell
from pcmrs_sim.process.channel import Channel
from pcmrs_sim.process.wire import (
    Alive,
    ArmState,
    Call,
    Cancel,
    Event,
    Failure,
    Open,
    Opened,
    Reply,
    ServoPoint,
    ToNode,
    TrackerPoses,
    Trouble,
    pack,
    read_by_world,
)

T = TypeVar("T")

LATE = 0.5
"""A call that acts and was so long on its way is refused, s of the machine: the world was not served meanwhile."""
REST_TIME = 1.0
"""An arm has come to rest so long after its node has ended, s of the machine."""
LOOK = 0.01

log = structlog.get_logger(__name__)


class Server:
    """The devices of a cell, for the node at the other end of a link.

    Args:
        link: To the node.

    Attributes:
        cell: That it serves, once the node has asked for it.
    """

    def __init__(self, link: socket.socket) -> None:
        self._machine = SystemClock()
        self._asked: asyncio.Future[Open | None] = asyncio.get_running_loop().create_future()
        self._ended = asyncio.Event()
        self._running: dict[int, asyncio.Task[None]] = {}
        self.cell: CellSimulation
        self._deadman: Deadman
        self._served: Collection[str] = ()
        self._trouble: dict[str, str] = {}
        self._channel = Channel(link, self._receive, self._end)

    async def run(self) -> None:
        """Opens the cell that the node asks for, and serves it until the node has ended."""
        asked = await self._asked
        if asked is None:
            return
        clock = SystemClock(asked.settings.get("cell", {}).get("rate", 1.0))
        try:
            async with open_cell(asked.devices, asked.settings, clock) as cell:
                keep_pauses_short()
                await self._serve(cell, asked)
        except PcmrsError as error:
            self._send(Opened(Failure.of(error)))

    async def _serve(self, cell: CellSimulation, asked: Open) -> None:
        limit = asked.settings.get("robot", {}).get("deadman", DEADMAN)
        self.cell, self._served = cell, asked.devices
        self._deadman = Deadman(limit, self._at_risk, self._act, self._machine)
        cell.listen = self._channel.receive
        works = [self._ended.wait(), self._deadman.run(), *self._streams(cell)]
        with cell.watched(self._tell_trouble):
            self._send(Opened())
            tasks = [asyncio.ensure_future(work) for work in works]
            try:
                await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
                await self._come_to_rest(cell)
            finally:
                tasks += self._running.values()
                for task in tasks:
                    task.cancel()
                await asyncio.gather(*tasks, return_exceptions=True)

    def _streams(self, cell: CellSimulation) -> Iterator[Coroutine[Any, Any, None]]:
        """What sends the measurements and events of the served devices."""
        if "tracker" in self._served:
            yield self._send_all(cell.tracker.frames(), lambda frame: TrackerPoses(list(frame)), dated=True)
        if "robot" in self._served:
            yield self._send_all(cell.robot.states(), lambda state: ArmState(state, cell.robot.dropped), dated=True)
            yield self._send_all(cell.robot.events(), Event)
        if "stimulator" in self._served:
            yield self._send_all(cell.stimulator.events(), Event)

    async def _send_all(self, values: AsyncIterator[T], message: Callable[[T], ToNode], *, dated: bool = False) -> None:
        async for value in values:
            self._send(message(value), dated=dated)

    def _send(self, message: ToNode, *, dated: bool = False) -> None:
        self._channel.send(pack(message), dated=dated)

    def _tell_trouble(self) -> None:
        """A device that sends nothing says why; its node answers for it, and cannot ask for each answer."""
        for name, device in (("robot", self.cell.robot), ("tracker", self.cell.tracker)):
            text = device.trouble
            if text != self._trouble.get(name, ""):
                self._trouble[name] = text
                self._send(Trouble(name, text))

    def _receive(self, body: bytes) -> None:
        match read_by_world(body):
            case Alive(beat):
                self._deadman.take_beat(beat)
            case ServoPoint(setpoint):
                self.cell.robot.set_point(setpoint)
            case Call() as call:
                self._begin(call)
            case Cancel(number):
                if number in self._running:
                    self._running[number].cancel()
            case Open() as asked:
                self._asked.set_result(asked)

    def _begin(self, call: Call) -> None:
        if (call.device, call.method) == ("robot", HOLDS["robot"]):
            self.cell.robot.brake()  # at once: the world may be in the middle of its steps
        task = self._running[call.number] = asyncio.create_task(self._answer(call))
        task.add_done_callback(lambda _: self._running.pop(call.number))

    async def _answer(self, call: Call) -> None:
        try:
            self._check_fresh(call)
            device = self.cell.devices[call.device]
            reply = Reply(call.number, await call_method(call.device, device, call.method, call.arguments))
        except PcmrsError as error:
            reply = Reply(call.number, failure=Failure.of(error))
        except Exception:
            log.exception("call_failed", device=call.device, method=call.method)
            text = f"The simulated {call.device} has failed in {call.method}; the log says why."
            reply = Reply(call.number, failure=Failure.of(UnknownOutcomeError(text)))
        self._send(reply)

    def _check_fresh(self, call: Call) -> None:
        late = self._machine.monotonic() - call.sent
        if late > LATE and call.method in ACTS.get(call.device, ()):
            text = f"{call.device}.{call.method} came {late:.1f} s late, and the simulated cell takes it only within "
            text += f"{LATE:g} s: ask again."
            raise DeviceError(text, late=late, limit=LATE)

    async def _at_risk(self) -> bool:
        return self.cell.acts(self._served)

    async def _act(self, silence: Silence) -> None:
        self._make_safe(f"nothing was heard of its node for {silence.lasted:.2f} s")

    def _make_safe(self, why: str) -> None:
        log.warning("held_by_world", reason=why)
        self.cell.lose_node(self._served, why)

    def _end(self) -> None:
        self._ended.set()
        if not self._asked.done():
            self._asked.set_result(None)

    async def _come_to_rest(self, cell: CellSimulation) -> None:
        """Brakes what its node has left in motion, and sees it stand."""
        if cell.acts(self._served):
            self._make_safe("its node has ended")
        end = self._machine.monotonic() + REST_TIME
        while "robot" in self._served and cell.robot.moving and self._machine.monotonic() < end:
            await self._machine.sleep(LOOK)
        log.info("simulated_cell_ends", moving=cell.robot.moving)
