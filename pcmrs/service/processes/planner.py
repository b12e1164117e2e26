"""Planning of motions in a child process, so that the event loop goes on meanwhile."""

from __future__ import annotations

import asyncio
import pickle
from collections.abc import Callable, Sequence
from contextlib import suppress

import structlog

from pcmrs.clock import Clock
from pcmrs.dispatcher import Run
from pcmrs.dispatcher.execution import reason_of
from pcmrs.errors import RefusalError
from pcmrs.fsm import Blueprint
from pcmrs.killing import kill_and_wait
from pcmrs.messages import DeviceEvent, Reason
from pcmrs.processes.starting import Process, ProcessStarter
from pcmrs.service.supervisor import RESTARTS, WITHIN, RestartLimit, Supervisor
from pcmrs.settings import Settings
from pcmrs.workflows.cell import Cell
from pcmrs.workflows.data import PlacementData
from pcmrs.workflows.planning import PlanAnswer, PlanningSettings, PlanRequest, apply_answer, request_of, too_late
from pcmrs.workflows.planning_process import HEADER, frame_message

log = structlog.get_logger(__name__)

PLANNING_TIME = 5.0
"""Limit to plan a motion before it is rejected, s of the machine; a process that takes longer is restarted."""
STARTING_TIME = 120.0
"""Limit of the daemon's wait for the process at the start, s; without the process motions are rejected."""
PAUSE = 10.0
"""Pause between two starts of a process that keeps ending, s."""


class PlanningProcess:
    """Child process for the checks that take long, as a `pcmrs.dispatcher.execution.MotionChecker`.

    A process that has ended, or does not answer in time, is restarted. Until the new one is ready, and for requests to
    the old one, the answer is a refusal: ``planner_lost`` or ``planner_late``.

    Args:
        settings: Settings of the daemon.
        clock: The machine's clock.
        start_process: Starts the process.

    Attributes:
        report: Takes the event that the process has ended by itself.
    """

    def __init__(self, settings: Settings, clock: Clock, start_process: ProcessStarter) -> None:
        self.report: Callable[[DeviceEvent], None] = lambda _: None
        self._settings = settings
        self._start_process = start_process
        self._clock = clock
        self._start = b""
        self._number = 0
        self._pending: dict[int, asyncio.Future[PlanAnswer]] = {}
        self._ready = asyncio.Event()
        self._process: Process | None = None

    async def check(
        self, run: Run[Cell, PlacementData], checks: Sequence[str], within: float | None = None
    ) -> Reason | None:
        """See `MotionChecker`; the present joints must be those of the plan."""
        request = request_of(run, checks)
        try:
            answer = await self._ask(request, f"{request.command.branch}.{request.command.operation}", within)
        except RefusalError as refusal:
            return reason_of(refusal)
        return apply_answer(run, request, answer)

    def start(self, supervisor: Supervisor, blueprint: Blueprint, cell: Cell) -> None:
        """Start the process, and keep it running.

        Args:
            supervisor: Supervisor of the task that keeps it running.
            blueprint: The verified blueprint of the daemon's workflow.
            cell: Cell of the daemon, whose surface of the body and calibrated poses the process gets.
        """
        settings = self._settings
        procedure = settings.procedure.in_cell_time(settings.cell.rate)
        start = PlanningSettings(
            settings.workflow, blueprint, procedure, settings.robot.model, cell.surface, cell.mounting
        )
        self._start = frame_message(0, pickle.dumps(start, pickle.HIGHEST_PROTOCOL))
        supervisor.start("planner", self._keep)

    async def wait(self) -> None:
        """Wait until the process is ready, within a limit."""
        try:
            async with self._clock.timeout(STARTING_TIME):
                await self._ready.wait()
        except TimeoutError:
            log.warning("planner_not_ready", after=STARTING_TIME)

    async def stop(self) -> None:
        """Kill the process, which has no state to lose and may be planning, and wait for its end."""
        process = self._process
        if process is not None:
            await kill_and_wait(process)

    async def _ask(self, request: PlanRequest, name: str, within: float | None = None) -> PlanAnswer:
        """Return the answer; raise `RefusalError` if none comes."""
        limit = PLANNING_TIME if within is None else within
        process = self._process
        if process is None or process.stdin is None or not self._ready.is_set():
            text = f"The process that plans motions does not run yet, so {name} was not planned: ask again in a moment."
            raise RefusalError("planner_lost", text)
        self._number += 1
        number, answered = self._number, asyncio.get_running_loop().create_future()
        self._pending[number] = answered
        process.stdin.write(frame_message(number, pickle.dumps(request, pickle.HIGHEST_PROTOCOL)))
        try:
            async with self._clock.timeout(limit):
                answer: PlanAnswer = await answered
        except TimeoutError:
            with suppress(ProcessLookupError):
                process.kill()
            raise too_late(name, limit) from None
        finally:
            self._pending.pop(number, None)
        return answer

    async def _keep(self) -> None:
        limit = RestartLimit(RESTARTS, WITHIN, self._clock)
        while True:
            process = self._process = await self._begin()
            await self._take_answers(process)
            status = await process.wait()
            self._lose(status)
            if limit.reached():
                await self._clock.sleep(PAUSE)

    async def _begin(self) -> Process:
        process = await self._start_process("pcmrs.workflows.planning_process", stdout=asyncio.subprocess.PIPE)
        if process.stdin is not None:
            process.stdin.write(self._start)
        return process

    async def _take_answers(self, process: Process) -> None:
        """Take answers until the process ends."""
        answers = process.stdout
        while answers is not None:
            try:
                number, length = HEADER.unpack(await answers.readexactly(HEADER.size))
                content = await answers.readexactly(length)
            except asyncio.IncompleteReadError:
                return
            if number == 0:
                self._ready.set()
            elif number in self._pending and not self._pending[number].done():
                _give(self._pending[number], content)

    def _lose(self, status: int) -> None:
        self._process = None
        self._ready.clear()
        text = f"The process that plans motions ended by itself (status {status}) and is restarted."
        for answered in self._pending.values():
            if not answered.done():
                answered.set_exception(RefusalError("planner_lost", f"{text} Ask again.", status=status))
        log.error("planner_ended", status=status)
        text += " What moves goes on; until it is ready, motions are rejected."
        self.report(DeviceEvent(device="daemon", code="planner_restarted", text=text, fields={"status": status}))


def _give(answered: asyncio.Future[PlanAnswer], content: bytes) -> None:
    """Set the answer. If it cannot be read, its error is the answer: a user's check may find what cannot be sent."""
    try:
        answered.set_result(pickle.loads(content))  # noqa: S301  # of the daemon's child, which reads no file
    except Exception as error:
        answered.set_exception(error)
