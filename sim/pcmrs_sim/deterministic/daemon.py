"""The daemon of a simulated cell: all of `pcmrs.service` except sockets, child processes and the real bus."""

from __future__ import annotations

import asyncio
import uuid
from collections.abc import Callable
from contextlib import AsyncExitStack
from pathlib import Path

from pcmrs.bus.bridge import ARRIVED
from pcmrs.dispatcher import Dispatcher, Workflow
from pcmrs.journal import JournalReader
from pcmrs.messages import BlueprintTag, Command, Verdict
from pcmrs.service.procedure import Clocks, RunningProcedure
from pcmrs.service.restart.recorder import JournalRecorder
from pcmrs.service.restart.recovery import conclude, keep_journal, recover
from pcmrs.service.supervisor import Supervisor
from pcmrs.settings import Settings
from pcmrs.simulated_time.clock import SimulatedClock
from pcmrs.workflows.cell import Cell
from pcmrs.workflows.data import PlacementData
from pcmrs_sim.deterministic.disk import Disk, SimulatedJournal
from pcmrs_sim.deterministic.gateway import SimulatedGateway
from pcmrs_sim.deterministic.network import Endpoint
from pcmrs_sim.deterministic.planner import SimulatedPlanner
from pcmrs_sim.deterministic.stops import open_lane

COMMANDS = "cmd/*/*/*"

ProcedureDispatcher = Dispatcher[Cell, PlacementData]
Observe = Callable[[ProcedureDispatcher, JournalReader], None]


class SimulatedDaemon:
    """One run of the daemon. Each restart makes a new one.

    Args:
        link: Its endpoint on the network.
        settings: The whole configuration.
        workflow: The opened procedure.
        clock: Clock of the daemon's host.
        disk: Disk that holds its journal.
        path: Journal file.
        observe: Called with the dispatcher and the journal before the first decision.

    Attributes:
        procedure: The running procedure; None before it has started.
        journal: Journal that it writes.
        link: Its endpoint on the network.
    """

    def __init__(
        self,
        link: Endpoint,
        settings: Settings,
        workflow: Workflow[Cell, PlacementData],
        clock: SimulatedClock,
        disk: Disk,
        path: Path,
        observe: Observe,
    ) -> None:
        self.procedure: RunningProcedure | None = None
        self.link = link
        self.journal = SimulatedJournal.on_disk(path, disk)
        self._window = disk.window
        self._settings = settings
        self._workflow = workflow
        self._clock = clock
        self._path = path
        self._observe = observe
        self._ending = asyncio.Event()
        self._started: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        self._gateway: SimulatedGateway | None = None
        self._main: asyncio.Task[None] | None = None

    async def start(self) -> None:
        """Start; return when it takes commands.

        Raises:
            PcmrsError: It cannot start, for a reason for which `pcmrs.service._daemon.Daemon` cannot start, either.
        """
        self._main = self.link.spawn(self._run())
        await asyncio.wait([self._main, self._started], return_when=asyncio.FIRST_COMPLETED)
        if self._main.done() and not self._main.cancelled():
            self._main.result()

    async def end(self) -> None:
        """End in order: hold the robot, then close everything."""
        self._ending.set()
        if self._main is not None:
            await asyncio.wait([self._main])
        self.link.leave()
        await self.link.ended()
        await self.journal.close()  # last, because the end of the procedure still writes rows

    async def crash(self) -> None:
        """End at once, as SIGKILL does: nothing more is sent, written or answered."""
        self.journal.abandon()  # first: rows that tasks append while they are cancelled must not become durable
        self.link.leave()
        await self.link.ended()
        await self.journal.close()

    def receive(
        self, port: int, data: bytes, answer: Callable[[str], None], acknowledge: Callable[[str], None] | None
    ) -> None:
        """Take a datagram at the planner link. It is lost while the gateway does not run.

        Args:
            port: UDP port from which the client sent it.
            data: Payload.
            answer: Called with the verdict.
            acknowledge: Called with the acknowledgement that old clients expect; None for other clients.
        """
        if self._gateway is not None:
            self._gateway.receive(port, data, answer, acknowledge)

    def lose(self, devices: list[str]) -> None:
        """Report that the process that served these devices has ended.

        Args:
            devices: Names of the devices.
        """
        if self.procedure is not None:
            # In the daemon's context, so that the tasks which this starts end with the daemon.
            self.link.context.copy().run(self.procedure.lose, devices)

    async def _run(self) -> None:
        settings, clock = self._settings, self._clock
        blueprint = self._workflow.blueprint
        tag = BlueprintTag(id=blueprint.id, version=blueprint.version, hash=blueprint.hash)
        journal = self.journal
        recorder = JournalRecorder(journal, clock, uuid.uuid4().hex, tag)
        recovered = await recover(journal, recorder, self._workflow, settings)
        async with AsyncExitStack() as stack:
            stack.push_async_callback(conclude, recorder)
            supervisor = Supervisor(clock)
            planner = SimulatedPlanner(self._workflow, settings, clock, self._window)
            clocks = Clocks(clock, clock)
            procedure = RunningProcedure(
                self.link, settings, recovered.workflow, recorder, clocks, supervisor, planner=planner
            )
            self.procedure, dispatcher = procedure, procedure.dispatcher
            recovered.give_to(dispatcher, journal)
            recorder.attach(dispatcher.procedure)
            self._observe(dispatcher, journal.reader)
            await stack.enter_async_context(supervisor)
            supervisor.start("journal", lambda: keep_journal(journal, recorder, dispatcher, clock))
            procedure.start()
            await procedure.readiness.wait()
            self._open_edges(stack, procedure)
            self.link.publish("state/fsm", dispatcher.snapshot())
            stack.push_async_callback(dispatcher.close)
            self._started.set_result(None)
            await self._ending.wait()

    def _open_edges(self, stack: AsyncExitStack, procedure: RunningProcedure) -> None:
        async def submit(_key: str, command: Command) -> Verdict:
            return await procedure.command_metrics.submit(command, arrived=ARRIVED.get())

        self.link.serve(COMMANDS, Command, submit)
        stack.callback(self.link.end, COMMANDS)
        stack.callback(open_lane(self.link, procedure.stop).end)
        folder = self._path.parent / "records"
        self._gateway = SimulatedGateway(procedure.core, self._settings.gateway, self._clock, folder)
        stack.push_async_callback(self._gateway.close)
