"""The composition root of `pcmrs-serve`: the only module that knows all parts."""

from __future__ import annotations

import asyncio
import fcntl
import uuid
from collections.abc import AsyncIterator, Callable, Iterator
from contextlib import AsyncExitStack, asynccontextmanager, contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import msgspec
import structlog

from pcmrs.bus import Bus, CommandEdge
from pcmrs.clock import Clock, SystemClock
from pcmrs.devices.dwell import DwellPointer
from pcmrs.devices.jumps import PoseLimits
from pcmrs.devices.poses import PoseFeed
from pcmrs.devices.remote import RemoteEmg, RemotePointer, RemoteRobot, RemoteStimulator
from pcmrs.dispatcher import Dispatcher, Workflow
from pcmrs.errors import ConfigurationError, DeviceError
from pcmrs.gateway.links import open_gateway
from pcmrs.journal import Journal
from pcmrs.kinematics.model import ArmModel
from pcmrs.kinematics.urdf_arms import find_arm
from pcmrs.messages import BlueprintTag, BodyPose, DeviceEvent, DeviceHealth, JointState, Snapshot, Verdict
from pcmrs.service.core import GatewayCore
from pcmrs.service.health import HealthWatch
from pcmrs.service.hearing import Hearing, awaited
from pcmrs.service.nodes import NodeProcesses
from pcmrs.service.publishing import Publishing, answer_queries
from pcmrs.service.recorder import JournalRecorder
from pcmrs.service.reference import ReferenceWatch
from pcmrs.service.resume import migration_for
from pcmrs.service.watch import RobotWatch
from pcmrs.settings import DWELL, Settings
from pcmrs.workflows import find_workflow, open_workflow
from pcmrs.workflows.cell import Cell
from pcmrs.workflows.data import PlacementData
from pcmrs.workflows.settings import TrackingSettings

log = structlog.get_logger(__name__)


class Ready(msgspec.Struct, frozen=True):
    """Where a running daemon can be reached.

    Attributes:
        prefix: Prefix of all its keys on the bus.
        links: Host and port of every gateway link.
        folder: Journal and records.
        journal: The journal of its workflow.
    """

    prefix: str
    endpoint: str
    links: dict[str, tuple[str, int]]
    folder: str
    journal: str
    workflow: str
    rate: float


class Daemon:
    """One running cell."""

    def __init__(self, settings: Settings) -> None:
        self._settings = settings
        self._tasks: set[asyncio.Task[Any]] = set()

    @asynccontextmanager
    async def running(self) -> AsyncIterator[Ready]:
        """Runs the daemon for as long as the context lasts; on leaving, motion is held first.

        Raises:
            ConfigurationError: Another daemon runs this cell, a port is taken, there is no such workflow, or the
                journal is of another version of it.
            BusError: The bus endpoint is taken.
            BlueprintError: The workflow is unsound.
            JournalError: The journal cannot be opened.
            DeviceError: A device is not heard.
        """
        settings = self._settings
        workflow = open_workflow(settings.workflow)
        clock = SystemClock(settings.cell.rate)
        folder = settings.cell.path()
        async with AsyncExitStack() as stack:
            stack.enter_context(_only_daemon_of(folder))
            bus = await Bus.open(settings.bus("router"))
            stack.push_async_callback(bus.close)
            blueprint = workflow.blueprint
            journal = Journal.open(settings.cell.journal(blueprint.id), durable=settings.journal.durable)
            stack.push_async_callback(journal.close)
            migration = migration_for(journal.reader, blueprint, find_workflow(settings.workflow).blueprint)
            tag = BlueprintTag(id=blueprint.id, version=blueprint.version, hash=blueprint.hash)
            recorder = JournalRecorder(journal, clock, uuid.uuid4().hex, tag)
            if migration is not None:
                await recorder.taken_up(migration)
            for verdict in await recorder.close_unfinished():
                log.warning("unknown_outcome", command=verdict.id, operation=f"{verdict.branch}.{verdict.operation}")
            workflow = replace(workflow, initial=recorder.previous(workflow.initial))
            cell = _open_cell(settings, bus, clock)
            dispatcher = _open_dispatcher(bus, workflow, cell, clock, recorder)
            await self._start_devices(stack, bus, cell, dispatcher)
            stack.push_async_callback(self._end_tasks)
            edge = await CommandEdge.open(bus, dispatcher.submit, self._stopper(dispatcher))
            stack.push_async_callback(edge.close)
            core = GatewayCore(dispatcher, cell)
            gateway = await stack.enter_async_context(
                open_gateway(core, settings.gateway, SystemClock(), folder / "records")
            )
            answer_queries(bus, dispatcher, journal.reader)
            bus.alive("daemon")
            bus.publish("state/fsm", dispatcher.snapshot())
            # Entered last, so left first: the arm stands, and latched, before anything else ends.
            stack.push_async_callback(dispatcher.close)
            yield Ready(
                prefix=bus.prefix,
                endpoint=settings.cell.endpoint,
                links=gateway.addresses,
                folder=str(folder),
                journal=str(journal.reader.path),
                workflow=f"{blueprint.id} {blueprint.version}",
                rate=settings.cell.rate,
            )

    async def _start_devices(
        self, stack: AsyncExitStack, bus: Bus, cell: Cell, dispatcher: Dispatcher[Cell, PlacementData]
    ) -> None:
        """Starts the nodes, and waits until their devices have been heard, or are known to be absent."""

        def connected() -> bool:
            return dispatcher.procedure.joint().get("robot") == "1"

        watch = RobotWatch(bus.publish, connected, lambda: dispatcher.in_doubt, dispatcher.report, SystemClock())
        hearing = Hearing(awaited(self._settings, dispatcher.procedure.blueprint.branches), SystemClock())

        def take_pose(_key: str, pose: BodyPose) -> None:
            cell.poses.update(pose)
            hearing.hear("tracker")

        def take_joints(_key: str, state: JointState) -> None:
            cell.update_joints(state)
            watch.hear()
            hearing.hear("robot")

        def lose(devices: list[str]) -> None:
            if not hearing.complete:
                text = f"The node of {', '.join(devices)} ended while it started; the log says why."
                hearing.fail(DeviceError(text, devices=devices))
            elif "robot" in devices:
                self._spawn(watch.lose("The robot's node has ended."))

        bus.subscribe("state/pose/*", BodyPose, take_pose)
        bus.subscribe("state/joints", JointState, take_joints)

        bus.subscribe("dev/*/state", DeviceHealth, HealthWatch(hearing, cell.poses).take)
        bus.subscribe("dev/*/event", DeviceEvent, lambda _, event: dispatcher.report_later(event))
        nodes = NodeProcesses(self._settings, lose)
        stack.push_async_callback(nodes.stop)
        await nodes.start()
        self._spawn(watch.run())
        self._spawn(ReferenceWatch(cell, dispatcher).run())
        await hearing.wait()

    def _stopper(self, dispatcher: Dispatcher[Cell, PlacementData]) -> Callable[[str], None]:
        def stop(source: str) -> None:
            self._spawn(dispatcher.stop(source))

        return stop

    def _spawn(self, work: Any) -> None:
        task = asyncio.get_running_loop().create_task(work)
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)

    async def _end_tasks(self) -> None:
        for task in self._tasks:
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)


def _open_cell(settings: Settings, bus: Bus, clock: SystemClock) -> Cell:
    procedure = settings.procedure
    # Answers are waited for by the machine's clock: a fast simulation may fall behind its own.
    machine = SystemClock()
    cell = Cell(
        name=f"{settings.cell.site}/{settings.cell.name}",
        robot=RemoteRobot(bus, machine),
        pointer=RemotePointer(bus, machine, procedure.registration.touch_timeout_s),
        stimulator=RemoteStimulator(bus, machine) if settings.stimulator.driver != "none" else None,
        emg=RemoteEmg(bus, machine) if settings.emg.driver != "none" else None,
        poses=PoseFeed(clock, procedure.max_pose_age, _pose_limits(procedure.tracking)),
        arm=ArmModel(find_arm(settings.robot.model)),
        clock=clock,
        settings=procedure,
    )
    if settings.pointer.driver == DWELL:
        cell.pointer = DwellPointer(cell.poses, clock, cell.pointer_from_tip, settings.pointer.dwell)
    log.info("calibration", **cell.calibrations(), id=cell.calibration_id)
    return cell


def _pose_limits(tracking: TrackingSettings) -> PoseLimits:
    return PoseLimits(tracking.error_mm / 1000.0, tracking.speed, tracking.turn, tracking.steady)


def _open_dispatcher(
    bus: Bus, workflow: Workflow[Cell, PlacementData], cell: Cell, clock: Clock, recorder: JournalRecorder
) -> Dispatcher[Cell, PlacementData]:
    publishing = Publishing(bus)

    def publish(message: Snapshot | Verdict | DeviceEvent) -> None:
        publishing.publish(message)
        publishing.publish_target(dispatcher.procedure.data)

    dispatcher = Dispatcher(workflow, cell, clock, recorder, cell.make_safe, publish)
    return dispatcher


@contextmanager
def _only_daemon_of(folder: Path) -> Iterator[None]:
    """Holds the lock of the cell's folder. Raises `ConfigurationError` when another daemon has it."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        lock = (folder / "lock").open("w")
    except OSError as error:
        raise ConfigurationError(f"{folder} cannot be used: {error.strerror}.", folder=str(folder)) from None
    with lock:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            text = f"Another daemon runs this cell ({folder}): stop it, or choose another cell.name and ports."
            raise ConfigurationError(text, folder=str(folder)) from None
        yield
