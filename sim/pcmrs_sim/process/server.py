"""The world's end of the link: answers the node, sends measurements, and supervises the node."""

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
    Failure,
    Open,
    Opened,
    Reply,
    ServoPoint,
    ToNode,
    TrackerPoses,
    Trouble,
    WorldEvent,
    pack,
    read_by_world,
)

T = TypeVar("T")

LARGEST_DELAY = 0.5
"""Age above which a call that acts is refused, s of the machine: the world was stalled, and the call is outdated."""
REST_TIME = 1.0
"""Time that the arm has to come to rest after its node has ended, s of the machine."""
REST_POLL_PERIOD = 0.01
"""Period of polls for that rest, s of the machine."""

log = structlog.get_logger(__name__)


class Server:
    """Server of the devices of a cell to the node at the other end of a link.

    Args:
        link: Connected socket to the node.

    Attributes:
        cell: The cell that it serves, once the node has opened it.
    """

    def __init__(self, link: socket.socket) -> None:
        self._machine = SystemClock()
        self._open_request: asyncio.Future[Open | None] = asyncio.get_running_loop().create_future()
        self._ended = asyncio.Event()
        self._running: dict[int, asyncio.Task[None]] = {}
        self.cell: CellSimulation
        self._deadman: Deadman
        self._served: Collection[str] = ()
        self._trouble: dict[str, str] = {}
        self._channel = Channel(link, self._receive, self._end)

    async def run(self) -> None:
        """Open the cell that the node requests, and serve it until the node has ended."""
        request = await self._open_request
        if request is None:
            return
        clock = SystemClock(request.settings.get("cell", {}).get("rate", 1.0))
        try:
            async with open_cell(request.devices, request.settings, clock) as cell:
                keep_pauses_short()
                await self._serve(cell, request)
        except PcmrsError as error:
            self._send(Opened(Failure.of(error)))

    async def _serve(self, cell: CellSimulation, request: Open) -> None:
        limit = request.settings.get("robot", {}).get("deadman", DEADMAN)
        self.cell, self._served = cell, request.devices
        self._deadman = Deadman(limit, self._at_risk, self._handle_silence, self._machine)
        cell.receive_calls = self._channel.receive
        coroutines = [self._ended.wait(), self._deadman.run(), *self._streams(cell)]
        with cell.watched(self._report_trouble):
            self._send(Opened())
            tasks = [asyncio.ensure_future(coroutine) for coroutine in coroutines]
            try:
                await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
                await self._bring_to_rest(cell)
            finally:
                tasks += self._running.values()
                for task in tasks:
                    task.cancel()
                await asyncio.gather(*tasks, return_exceptions=True)

    def _streams(self, cell: CellSimulation) -> Iterator[Coroutine[Any, Any, None]]:
        """Yield a coroutine for each stream of measurements and events of the served devices."""
        if "tracker" in self._served:
            yield self._send_all(cell.tracker.frames(), lambda frame: TrackerPoses(list(frame)), droppable=True)
        if "robot" in self._served:
            yield self._send_all(cell.robot.states(), lambda state: ArmState(state, cell.robot.dropped), droppable=True)
            yield self._send_all(cell.robot.events(), WorldEvent)
        if "stimulator" in self._served:
            yield self._send_all(cell.stimulator.events(), WorldEvent)

    async def _send_all(
        self, values: AsyncIterator[T], message: Callable[[T], ToNode], *, droppable: bool = False
    ) -> None:
        async for value in values:
            self._send(message(value), droppable=droppable)

    def _send(self, message: ToNode, *, droppable: bool = False) -> None:
        self._channel.send(pack(message), droppable=droppable)

    def _report_trouble(self) -> None:
        """Send the reason for which a device sends nothing, if it changed: the node reports it without a request."""
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
                self._start_call(call)
            case Cancel(number):
                if number in self._running:
                    self._running[number].cancel()
            case Open() as request:
                self._open_request.set_result(request)

    def _start_call(self, call: Call) -> None:
        if (call.device, call.method) == ("robot", HOLDS["robot"]):
            self.cell.robot.brake()  # now, and not in a task: the world may be amid a batch of steps
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
        if late > LARGEST_DELAY and call.method in ACTS.get(call.device, ()):
            text = f"{call.device}.{call.method} came {late:.1f} s late; the simulated cell accepts at most "
            text += f"{LARGEST_DELAY:g} s. Send the command again."
            raise DeviceError(text, late=late, limit=LARGEST_DELAY)

    async def _at_risk(self) -> bool:
        return self.cell.is_active(self._served)

    async def _handle_silence(self, silence: Silence) -> None:
        self._make_safe(f"its node has been silent for {silence.lasted:.2f} s")

    def _make_safe(self, why: str) -> None:
        log.warning("held_by_world", reason=why)
        self.cell.lose_node(self._served, why)

    def _end(self) -> None:
        self._ended.set()
        if not self._open_request.done():
            self._open_request.set_result(None)

    async def _bring_to_rest(self, cell: CellSimulation) -> None:
        """Brake an arm that the node has left in motion, and wait until it rests."""
        if cell.is_active(self._served):
            self._make_safe("its node has ended")
        end = self._machine.monotonic() + REST_TIME
        while "robot" in self._served and cell.robot.moving and self._machine.monotonic() < end:
            await self._machine.sleep(REST_POLL_PERIOD)
        log.info("simulated_cell_ends", moving=cell.robot.moving)
