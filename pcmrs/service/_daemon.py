"""The composition root of `pcmrs-serve`: the only module that knows all parts."""

from __future__ import annotations

import asyncio
import uuid
from collections.abc import AsyncIterator, Iterable, Iterator
from contextlib import AsyncExitStack, asynccontextmanager, contextmanager
from functools import partial
from pathlib import Path

import msgspec
import structlog

from pcmrs.background import BackgroundTasks, logged_as
from pcmrs.bus import Bus, CommandEdge
from pcmrs.bus.seal import Seal, new_key, new_run
from pcmrs.clock import Clock, SystemClock
from pcmrs.errors import ConfigurationError
from pcmrs.fsm import Blueprint
from pcmrs.gateway.links import TASK_FAILED, Gateway, open_gateway
from pcmrs.gateway.rejection_log import RejectionLog
from pcmrs.journal import Journal
from pcmrs.maintenance import enter_folder, hold_folder
from pcmrs.messages import BlueprintTag
from pcmrs.processes.starting import ProcessStarter, start_by_exec
from pcmrs.service._command_metrics import Source, counted
from pcmrs.service._setup_view import setup_of
from pcmrs.service.health.inspection import Inspection
from pcmrs.service.health.metrics import MetricsServer
from pcmrs.service.health.service_manager import ServiceManager, run_watchdog
from pcmrs.service.procedure import Clocks, RunningProcedure
from pcmrs.service.processes.child import ChildProcess
from pcmrs.service.processes.console import ConsoleListener, is_served
from pcmrs.service.processes.heart import HeartProcess
from pcmrs.service.processes.nodes import NodeProcesses
from pcmrs.service.processes.planner import PlanningProcess
from pcmrs.service.processes.recording import start_recording
from pcmrs.service.publishing import answer_queries, publish_health
from pcmrs.service.restart.audit import audit
from pcmrs.service.restart.recorder import JournalRecorder
from pcmrs.service.restart.recovery import approval_of, conclude, keep_journal, recover
from pcmrs.service.supervisor import Supervisor
from pcmrs.service.watches.space import MEGABYTE, SpaceWatch
from pcmrs.service.watches.stall import StallWatch
from pcmrs.settings import Settings
from pcmrs.threads import NOT_PERMITTED, Priority, RealTime, keep_pauses_short
from pcmrs.workflows.opening import open_workflow

log = structlog.get_logger(__name__)

RECORDER_ENDING_TIME = 15.0
"""Limit for the recorder to finish its file, s: it has a low priority, so that takes long on a busy machine."""
CONSOLE_ENDING_TIME = 5.0
"""Limit for the console to end, s."""


class Ready(msgspec.Struct, frozen=True):
    """Addresses of a running daemon.

    Attributes:
        prefix: Prefix of all its keys on the bus.
        links: Host and port of every gateway link.
        folder: Journal and records.
        journal: The journal of its workflow.
        metrics: Address of its metrics; empty if none are served.
        console: Address of its page, which is served once it is opened; empty if none is.
        listen: Addresses for other machines.
        routers: Routers that it connects to.
    """

    prefix: str
    endpoint: str
    links: dict[str, tuple[str, int]]
    folder: str
    journal: str
    workflow: str
    rate: float
    metrics: str = ""
    console: str = ""
    listen: tuple[str, ...] = ()
    routers: tuple[str, ...] = ()


class Daemon:
    """One running cell.

    Args:
        settings: Its settings.
        start_process: Starts its child processes.
    """

    def __init__(self, settings: Settings, start_process: ProcessStarter = start_by_exec) -> None:
        self._settings = settings
        self._start_process = start_process

    @asynccontextmanager
    async def running(self) -> AsyncIterator[Ready]:
        """Run the daemon as long as the context lasts; when it is left, motion is held first.

        Raises:
            ConfigurationError: Another daemon runs this cell, a port is taken, there is no such workflow, it is a draft
                that nobody has approved, or the journal is of another version of it.
            BusError: The bus endpoint is taken.
            BlueprintError: The workflow is unsound.
            JournalError: The journal cannot be opened.
            DeviceError: A device has not answered.
            SupervisionError: When the context is left: one of the daemon's tasks has died too often.
        """
        settings = self._settings
        workflow = open_workflow(settings.workflow)
        clock, machine = SystemClock(settings.cell.rate), SystemClock()
        approval = approval_of(workflow, settings, machine.wall())
        manager, metrics = ServiceManager(), MetricsServer(settings.metrics.port)
        session = uuid.uuid4().hex
        async with AsyncExitStack() as stack:
            stack.enter_context(_own_folder(settings.cell.path()))
            device_key = (settings.access.read_device_key() or new_key()) + new_run()
            bus = await Bus.open(settings.bus("router"), Seal(device_key, daemon=True))
            stack.push_async_callback(bus.close)
            blueprint = workflow.blueprint
            journal = Journal.open(
                settings.cell.journal(blueprint.id),
                durable=settings.journal.durable,
                largest=settings.journal.largest_mb * MEGABYTE,
            )
            stack.push_async_callback(journal.close)
            earlier = journal.reader.last_sequence()
            tag = BlueprintTag(id=blueprint.id, version=blueprint.version, hash=blueprint.hash)
            recorder = JournalRecorder(journal, clock, session, tag)
            recovered = await recover(journal, recorder, workflow, settings, approval)
            stack.push_async_callback(conclude, recorder)
            supervisor = Supervisor(machine)
            clocks = Clocks(clock, machine)
            heart = HeartProcess(settings.bus("client"), machine, device_key, self._start_process)
            planner = PlanningProcess(settings, machine, self._start_process)
            procedure = RunningProcedure(
                bus, settings, recovered.workflow, recorder, clocks, supervisor, heart, planner
            )
            dispatcher = procedure.dispatcher
            heart.report = planner.report = dispatcher.report_later
            recovered.give_to(dispatcher, journal)
            recovered.restore_initial_joints(procedure.cell)
            recorder.attach(dispatcher.procedure)
            page = ConsoleListener(self._start_process, settings)
            stack.callback(page.close)
            children = _child_processes(settings, session, device_key, procedure, machine, self._start_process, page)
            nodes, recording, console = await stack.enter_async_context(children)
            stack.push_async_callback(heart.stop)
            stack.push_async_callback(planner.stop)
            asyncio.get_running_loop().set_exception_handler(supervisor.handle_loop_exception)
            await stack.enter_async_context(supervisor)
            supervisor.start("journal", lambda: keep_journal(journal, recorder, dispatcher, machine))
            space = SpaceWatch(
                settings.cell.path(),
                settings.journal.warn_free_mb,
                settings.journal.least_free_mb,
                dispatcher.suspend,
                dispatcher.report_later,
                machine,
            )
            supervisor.start("disk watch", space.run)
            procedure.start()
            heart.start(supervisor)
            planner.start(supervisor, blueprint, procedure.cell)
            nodes.start(supervisor)
            await procedure.readiness.wait()
            await planner.wait()
            stalls = StallWatch(dispatcher.report_later, machine)
            stack.push_async_callback(stalls.close)
            stalls.start()
            gateway = await stack.enter_async_context(_edges(bus, procedure, settings, machine))
            sources = (bus.counters, supervisor.counters, stalls.counters, procedure.counters, gateway.counters.table)
            stack.callback(_log_counters, sources)
            inspection = Inspection(
                blueprint=tag,
                drivers=settings.drivers(),
                machine=machine,
                bus=bus,
                journal=journal,
                space=space,
                supervisor=supervisor,
                procedure=procedure,
                nodes=nodes,
                recording=recording,
                console=console,
                stalls=stalls,
                gateway=gateway,
                metrics_trouble=lambda: metrics.trouble,
            )
            shown = partial(setup_of, procedure.cell, settings, workflow)
            answer_queries(bus, dispatcher, journal.reader, inspection.health, shown, procedure.gathered)
            stack.push_async_callback(metrics.close)
            metrics.start(inspection.health)
            bus.alive("daemon")
            bus.publish("state/fsm", dispatcher.snapshot())
            if settings.recording.enabled:
                recording.start(supervisor)
            if is_served(settings):
                page.open()  # before the address is printed
                console.start(supervisor)
            supervisor.start("real-time policy", lambda: keep_real_time_policy(machine))
            supervisor.start("health", lambda: publish_health(bus, inspection.health, machine))
            if earlier:
                supervisor.spawn("audit", audit(journal.reader.path, dispatcher.report_later))
            if manager:
                supervisor.start("service manager", lambda: run_watchdog(manager, inspection.health, machine))
            # It is entered last, so left first: the arm stands and is latched before anything else ends.
            stack.push_async_callback(dispatcher.close)
            manager.notify("READY=1")
            stack.callback(manager.notify, "STOPPING=1")
            yield _ready(settings, blueprint, bus, journal, gateway, metrics, page)


@asynccontextmanager
async def _child_processes(
    settings: Settings,
    session: str,
    device_key: bytes,
    procedure: RunningProcedure,
    machine: Clock,
    start: ProcessStarter,
    page: ConsoleListener,
) -> AsyncIterator[tuple[NodeProcesses, ChildProcess, ChildProcess]]:
    """Yield device nodes, recorder and console, not yet started; they are stopped in this order."""
    report = procedure.dispatcher.report_later
    nodes = NodeProcesses(settings, device_key, procedure.lose, report, machine, start)
    recording = ChildProcess(
        "recording",
        partial(start_recording, start, settings, session, machine, device_key),
        report,
        machine,
        RECORDER_ENDING_TIME,
    )
    console = ChildProcess("console", page.begin, report, machine, CONSOLE_ENDING_TIME, page.close)
    async with AsyncExitStack() as stack:
        stack.push_async_callback(console.stop)
        stack.push_async_callback(recording.stop)  # after the nodes, so that it writes their last messages
        stack.push_async_callback(nodes.stop)
        yield nodes, recording, console


@asynccontextmanager
async def _edges(bus: Bus, procedure: RunningProcedure, settings: Settings, machine: Clock) -> AsyncIterator[Gateway]:
    """Take commands from the bus and from the links of the gateway, which are closed first."""
    async with AsyncExitStack() as stack:
        reporting = BackgroundTasks(logged_as(TASK_FAILED))
        stack.push_async_callback(reporting.close)
        refusals = RejectionLog(procedure.core, machine, reporting, edge="bus")
        edge = await CommandEdge.open(bus, procedure.command_metrics.submit, refusals.add, procedure.stop)
        stack.push_async_callback(edge.close)
        links = open_gateway(procedure.core, settings.gateway, machine, settings.cell.path())
        yield await stack.enter_async_context(links)


def _ready(
    settings: Settings,
    blueprint: Blueprint,
    bus: Bus,
    journal: Journal,
    gateway: Gateway,
    metrics: MetricsServer,
    page: ConsoleListener,
) -> Ready:
    return Ready(
        prefix=bus.prefix,
        endpoint=settings.cell.endpoint,
        links=gateway.addresses,
        folder=str(settings.cell.path()),
        journal=str(journal.reader.path),
        workflow=f"{blueprint.id} {blueprint.version}",
        rate=settings.cell.rate,
        metrics=metrics.address,
        console=page.address,
        listen=settings.access.listen,
        routers=settings.access.routers,
    )


async def keep_real_time_policy(machine: Clock) -> None:
    """Give the real-time policy to the loop and the threads of the bus; log once if a permission is missing."""
    keep_pauses_short()
    realtime = RealTime(Priority.LOOP)
    try:
        realtime.give()
    except PermissionError:
        log.warning("no_real_time_policy", text=NOT_PERMITTED)
    await realtime.keep(machine.sleep)


def _log_counters(sources: Iterable[Source]) -> None:
    found = {name: many for name, many in counted(sources).items() if many}
    log.debug("counted", **found)


@contextmanager
def _own_folder(folder: Path) -> Iterator[None]:
    """Hold the lock of the cell's folder. Raises `ConfigurationError` if this daemon must not use it."""
    with hold_folder(folder):
        try:
            enter_folder(folder)
        except OSError as error:
            raise ConfigurationError(f"{folder} cannot be used: {error.strerror}.", folder=str(folder)) from None
        yield
