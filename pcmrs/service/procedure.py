"""Running procedure of a cell: dispatcher, devices and watches, over any `Link` and in any time."""

from __future__ import annotations

import asyncio
from collections import defaultdict
from dataclasses import dataclass

import structlog

from pcmrs.bus.keys import named_in
from pcmrs.clock import Clock
from pcmrs.devices.calls import PROTOCOLS
from pcmrs.devices.dwell import DwellPointer
from pcmrs.devices.jumps import PoseLimits
from pcmrs.devices.link import Link
from pcmrs.devices.node import DAEMON_BEAT
from pcmrs.devices.poses import PoseFeed
from pcmrs.devices.remote import ActingDevice, RemoteEmg, RemotePointer, RemoteRobot, RemoteStimulator
from pcmrs.devices.standstill import Standstill
from pcmrs.dispatcher import Dispatcher, DispatcherListener, Recorder, Workflow
from pcmrs.dispatcher.decisions import Rejections
from pcmrs.dispatcher.execution import MotionChecker
from pcmrs.errors import ConfigurationError, DeviceError
from pcmrs.fsm import Blueprint
from pcmrs.kinematics.model import ArmModel
from pcmrs.kinematics.urdf_arms import find_arm
from pcmrs.messages import Beat, Beeps, BodyPose, DeviceEvent, DeviceHealth, JointState, NodeBeat, Snapshot, Verdict
from pcmrs.messages.scene_event import SceneEvent
from pcmrs.messages.setup import ProcedureDataView
from pcmrs.scene.checks import check_scene_events
from pcmrs.service._command_metrics import CommandMetrics
from pcmrs.service._setup_view import gathered
from pcmrs.service._teleoperation import connect_teleoperators
from pcmrs.service.gateway_adapter import GatewayAdapter
from pcmrs.service.processes.heart import BeatSender, LoopHeart
from pcmrs.service.publishing import Publishing
from pcmrs.service.supervisor import Supervisor
from pcmrs.service.watches.abandoned import AbandonedWatch
from pcmrs.service.watches.beats import NodeBeats
from pcmrs.service.watches.devices import HealthWatch
from pcmrs.service.watches.gates import GateWatch
from pcmrs.service.watches.lease import LeaseWatch
from pcmrs.service.watches.readiness import DeviceReadiness, awaited
from pcmrs.service.watches.reference import ReferenceWatch
from pcmrs.service.watches.robot import RobotWatch
from pcmrs.service.watches.scene import SceneWatch
from pcmrs.settings import DWELL, Settings
from pcmrs.workflows.cell import Cell
from pcmrs.workflows.data import PlacementData
from pcmrs.workflows.settings import TrackingSettings
from pcmrs.workflows.surface import read_surface

log = structlog.get_logger(__name__)

DEVICES = set(PROTOCOLS)
"""Devices that may report events."""
DAEMON_SPEAKERS = {"daemon", "recorder"}
"""Sources that report on the daemon's own key."""


@dataclass(frozen=True, slots=True)
class Clocks:
    """The two times of a cell.

    Attributes:
        cell: Time of robot, tracker and people.
        machine: Time in which processes wait for each other: answers, heartbeats.
    """

    cell: Clock
    machine: Clock


class RunningProcedure(DispatcherListener):
    """Procedure of one cell, without its own sockets, child processes or bus.

    Args:
        link: Link to the device nodes and to clients.
        settings: The whole configuration.
        workflow: The workflow, with what earlier runs have left in its initial data.
        recorder: The journal.
        clocks: Clocks of the cell and of the machine.
        supervisor: Supervisor of its tasks. It reports to the dispatcher from now on.
        heart: Sends the loop's signs of life; by default the loop itself does.
        planner: Plans motions; by default the loop itself does.

    Attributes:
        session: Id of this run of the daemon in its heartbeats and requests.
        cell: Devices and poses.
        dispatcher: The dispatcher.
        core: Adapter of the dispatcher for the gateway.
        command_metrics: Metrics of decisions.
        readiness: Readiness of the devices.
        health: Health that the nodes report of their devices.
        beat_times: Device to the time at which its node sent its last heartbeat, s of the machine's monotonic clock.
        data_times: Robot and tracker to the time of their last joints and poses, on the same clock.
        misnamed: Number of events that were dropped, since their device is not that of their key.
    """

    def __init__(
        self,
        link: Link,
        settings: Settings,
        workflow: Workflow[Cell, PlacementData],
        recorder: Recorder,
        clocks: Clocks,
        supervisor: Supervisor,
        heart: BeatSender | None = None,
        planner: MotionChecker[Cell, PlacementData] | None = None,
    ) -> None:
        self._heart = heart or LoopHeart(link.publish, clocks.machine)
        self.session = self._heart.session
        self._link = link
        self._supervisor = supervisor
        self.cell = open_cell(settings, workflow.blueprint, link, clocks, self.session)
        self._publishing = Publishing(link)
        self.dispatcher = Dispatcher(
            workflow,
            self.cell,
            clocks.cell,
            recorder,
            self.cell.make_safe,
            release=self.cell.release,
            lease_required=settings.access.is_open,
            planner=planner,
            rejections=Rejections(clocks.machine),
            limits=settings.procedure.limits,
        )
        self.dispatcher.add_listener(self)
        self.command_metrics = CommandMetrics(self.dispatcher.submit, clocks.machine)
        self.core = GatewayAdapter(self.dispatcher, self.cell, self.command_metrics.submit)
        self.readiness = DeviceReadiness(awaited(settings, workflow.blueprint.branches), clocks.machine)
        dispatcher = self.dispatcher
        self.watch = RobotWatch(
            self._heart.sign,
            self.connected,
            lambda: dispatcher.in_doubt,
            dispatcher.report,
            clocks.machine,
            settings.robot.deadman,
        )
        acting: tuple[object, ...] = (self.cell.robot, self.cell.pointer, self.cell.stimulator)
        remote = [device for device in acting if isinstance(device, ActingDevice)]
        self._gates = GateWatch(remote, dispatcher, self.connected, supervisor)
        self._standstill = Standstill()
        self.health = HealthWatch(self.readiness, self.cell.poses)
        self._beats: defaultdict[str, NodeBeats] = defaultdict(NodeBeats)
        self.beat_times: dict[str, float] = {}
        self.data_times: dict[str, float] = {}
        self._machine = clocks.machine
        self.misnamed = 0
        self._reference = ReferenceWatch(self.cell, dispatcher)
        self._abandoned = AbandonedWatch(dispatcher, settings.procedure.abandoned_after, clocks.machine)
        check_scene_events(settings.scene_events, workflow.blueprint, workflow.registry.payloads)
        self._scene = SceneWatch(settings.scene_events, dispatcher, clocks.machine)
        self._lease = LeaseWatch(dispatcher, self.moving, clocks.cell, settings.access.lease_s)
        supervisor.report = dispatcher.report

    def start(self) -> None:
        """Subscribe to the devices and start the watches."""
        link = self._link
        link.subscribe("state/pose/*", BodyPose, self._take_pose)
        link.subscribe("state/joints", JointState, self._take_joints)
        link.subscribe("dev/*/state", DeviceHealth, self.health.take)
        link.subscribe("dev/*/beat", NodeBeat, self._take_beat)
        link.subscribe(DAEMON_BEAT, Beat, lambda _key, _beat: self._heart.record_beat())
        link.subscribe("dev/*/event", DeviceEvent, self._take_event)
        link.subscribe("daemon/event", DeviceEvent, self._take_event)
        link.when_lost(self._lose_event)
        connect_teleoperators(link, self.cell.teleop, self._abandoned.see)
        self._supervisor.start("beats and robot watch", self.watch.run, quiet=QUIET)
        self._supervisor.start("reference watch", self._reference.run, quiet=QUIET)
        self._supervisor.start("abandoned watch", self._abandoned.run)
        if self._scene.has_sources:
            link.subscribe("scene/*", SceneEvent, self._scene.take)
            self._supervisor.start("scene watch", self._scene.run, quiet=QUIET)
        self._supervisor.start("lease watch", self._lease.run, quiet=QUIET)

    def connected(self) -> bool:
        """Return whether the robot is connected by the state of the workflow."""
        return self.dispatcher.procedure.joint().get("robot") == "1"

    def gathered(self) -> ProcedureDataView:
        """Return the present data of the procedure, for people."""
        return gathered(self.cell, self.dispatcher.procedure.data)

    def moving(self) -> bool:
        """Return whether the robot was moving by its last joints."""
        return self.cell.joints is not None and self.cell.joints.moving

    def stop(self, source: str, presses: int = 1) -> int:
        """Begin to stop everything, and return the number of the Stop; see `Dispatcher.press_stop`.

        Args:
            source: Who stops.
            presses: Number of presses of this source since the last call.
        """
        before = self.dispatcher.stop_number
        stop = self.dispatcher.press_stop(source, presses)
        if stop.number > before:
            self._supervisor.spawn(f"stop by {source}", _wait_for(stop.standing))
        return stop.number

    def lose(self, devices: list[str]) -> bool:
        """Handle that the node of these devices has ended by itself; return whether to restart it."""
        if not self.readiness.complete:
            text = f"The node of {', '.join(devices)} ended while it started; the log says why."
            self.readiness.fail(DeviceError(text, devices=devices))
            return False
        if "robot" in devices:
            self._supervisor.spawn("loss of the robot", self.watch.lose("The robot's node has ended."))
        if "stimulator" in devices:
            text = "The stimulator's node has ended, and with it what was armed: arm it again."
            self.dispatcher.report_later(DeviceEvent(device="stimulator", code="disarmed", text=text))
        return True

    def counters(self) -> dict[str, int]:
        """Return the numbers of messages that reached the device nodes too late, and of events of wrong senders."""
        found = self.health.last.items()
        late = {f"{device}.late.{kind}": many for device, said in found for kind, many in said.dropped.items()}
        scene = {"scene.foreign": self._scene.foreign} if self._scene.has_sources else {}
        return late | {"events.misnamed": self.misnamed} | scene

    def _take_event(self, key: str, event: DeviceEvent) -> None:
        """Report an event of the device that its key names: no device may report for the lease or the daemon."""
        speakers = DAEMON_SPEAKERS if key == "daemon/event" else {named_in(key)} & DEVICES
        if event.device in speakers:
            self.dispatcher.report_later(event)
            return
        self.misnamed += 1
        log.warning("misnamed_event", key=key, device=event.device, code=event.code)

    def _lose_event(self, key: str) -> None:
        """Stop: what was lost may have been a danger."""
        device = named_in(key) if key != "daemon/event" else "daemon"
        text = f"At least one event of the {device} is lost, because too many were waiting, or because it could not be "
        text += "read: it may have been a danger. Look at the cell, then acknowledge."
        self.dispatcher.report_later(DeviceEvent(device=device, code="events_lost", text=text, danger=True))

    def _take_pose(self, _key: str, pose: BodyPose) -> None:
        self.data_times["tracker"] = self._machine.monotonic()
        self.cell.poses.update(pose)
        self.readiness.record_message("tracker")

    def _take_joints(self, _key: str, state: JointState) -> None:
        self.data_times["robot"] = self._machine.monotonic()
        self.cell.update_joints(state)
        self._standstill.watch(self.connected() and self.dispatcher.idle)
        if (moved := self._standstill.take(state)) is not None:
            self.dispatcher.report_later(moved)
        self.watch.record_joints()
        self.readiness.record_message("robot")

    def _take_beat(self, key: str, beat: NodeBeat) -> None:
        device = named_in(key)
        self._gates.take(device, beat.gate)
        if beat.gate is not None:
            self.readiness.record_gate(device)
        alive = self._beats[device].take(beat, self._machine.monotonic())
        self.beat_times[device] = alive
        if device == "robot":
            self.watch.record_beat(alive)

    def on_publish(self, message: Snapshot | Verdict | DeviceEvent) -> None:
        """Publish a message of the dispatcher on the bus, and count it."""
        self.command_metrics.take(message)
        self._publishing.publish(message)
        self._publishing.publish_data(self.cell, self.dispatcher.procedure.data)


async def _wait_for(stopping: asyncio.Task[bool]) -> None:
    await stopping


QUIET = 10.0
"""Time without a mark after which a watch counts as stuck, s of the machine; it may wait for its reports."""


def open_cell(settings: Settings, blueprint: Blueprint, link: Link, clocks: Clocks, session: str) -> Cell:
    """Return the cell of a workflow's operations.

    Args:
        settings: The whole configuration.
        blueprint: The workflow.
        link: Link to the device nodes.
        clocks: Clocks of the cell and of the machine.
        session: Id of this run of the daemon.

    Raises:
        ConfigurationError: A calibration is missing or cannot be used, or the body's surface is missing or another
            patient's.
        FileFormatError: The surface is not a mesh.
    """
    procedure, machine = settings.procedure.in_cell_time(settings.cell.rate), clocks.machine
    _check_tool(settings, blueprint)
    cell = Cell(
        name=f"{settings.cell.site}/{settings.cell.name}",
        # Waits for answers use the machine's clock: a fast simulation may fall behind its own.
        robot=RemoteRobot(link, machine, session),
        uses_robot=blueprint.uses_robot,
        pointer=RemotePointer(link, machine, procedure.registration.touch_timeout_s, session),
        stimulator=RemoteStimulator(link, machine, session) if settings.stimulator.driver != "none" else None,
        emg=RemoteEmg(link, machine) if settings.emg.driver != "none" else None,
        poses=PoseFeed(clocks.cell, procedure.max_pose_age, _pose_limits(procedure.tracking)),
        arm=ArmModel(find_arm(settings.robot.model)),
        clock=clocks.cell,
        settings=procedure,
        surface=read_surface(procedure),
        point_to_point=settings.point_to_point,
    )
    if settings.pointer.driver == DWELL:
        cell.pointer = DwellPointer(cell.poses, clocks.cell, cell.pointer_from_tip, settings.pointer.dwell)
    if settings.tracker.beeps:
        cell.beep = lambda count: link.publish("dev/tracker/beep", Beeps(count=count))
    log.debug("calibration", **cell.calibrations(), id=cell.calibration_id)
    return cell


def _check_tool(settings: Settings, blueprint: Blueprint) -> None:
    """Refuse to place or track a real tool by the poses of the simulated one. Raises `ConfigurationError`."""
    unused = settings.tracker.driver == "none" and not blueprint.uses_robot
    given = not settings.procedure.calibration.of_simulated_tool
    if not (given or unused or settings.has_simulated_tool(blueprint.uses_robot)):
        text = (
            "procedure.calibration does not say where the tool is: give tool_file, which `pcmrs calibrate hand-eye` "
            "makes, and tip_file, which `pcmrs calibrate tip` makes (docs/calibration.md)."
        )
        raise ConfigurationError(text)


def _pose_limits(tracking: TrackingSettings) -> PoseLimits:
    return PoseLimits(tracking.error_mm / 1000.0, tracking.speed, tracking.turn, tracking.steady)
