"""Facts for the daemon's health, from all of its parts, read in the event loop."""

from __future__ import annotations

import platform
from collections.abc import Callable
from dataclasses import dataclass, field
from importlib.metadata import version

from pcmrs.bus import Bus
from pcmrs.bus.bridge import CAPACITY
from pcmrs.bus.serving import ANSWERS
from pcmrs.clock import Clock
from pcmrs.dispatcher.dispatcher import ENDING
from pcmrs.dispatcher.locks import MAX_WAITING
from pcmrs.gateway.links import Gateway
from pcmrs.journal import Journal
from pcmrs.journal.group import MOST_WAITING
from pcmrs.messages import BlueprintTag, DeviceHealth
from pcmrs.messages.health import (
    DeviceStatus,
    Health,
    HealthFacts,
    JournalStatus,
    LoopStatus,
    NodeStatus,
    QueueStatus,
    TaskStanding,
)
from pcmrs.service.health.report import report
from pcmrs.service.procedure import RunningProcedure
from pcmrs.service.processes.child import ChildProcess
from pcmrs.service.processes.nodes import NodeProcesses
from pcmrs.service.supervisor import Supervisor
from pcmrs.service.watches.space import MEGABYTE, SpaceWatch
from pcmrs.service.watches.stall import StallWatch

VERSIONS = {"pcmrs": version("pcmrs"), "python": platform.python_version()}


@dataclass(frozen=True, slots=True, kw_only=True)
class Inspection:
    """Collector of the facts of a running daemon from its parts.

    Attributes:
        drivers: Driver to the devices that its node serves.
        metrics_trouble: Why metrics are not served; empty while they are.
        began: Time at which the daemon started to serve, s of the machine's monotonic clock.
    """

    blueprint: BlueprintTag
    drivers: dict[str, list[str]]
    machine: Clock
    bus: Bus
    journal: Journal
    space: SpaceWatch
    supervisor: Supervisor
    procedure: RunningProcedure
    nodes: NodeProcesses
    recording: ChildProcess
    console: ChildProcess
    stalls: StallWatch
    gateway: Gateway
    metrics_trouble: Callable[[], str]
    began: float = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "began", self.machine.monotonic())

    def health(self) -> Health:
        """Return the present facts and the verdict on them."""
        return report(self._facts())

    def _facts(self) -> HealthFacts:
        dispatcher, metrics, stalls = self.procedure.dispatcher, self.procedure.command_metrics, self.stalls
        broken, own = dispatcher.broken, self.bus.settings.credentials
        return HealthFacts(
            uptime=self.machine.monotonic() - self.began,
            versions=VERSIONS,
            blueprint=self.blueprint,
            latched=dispatcher.procedure.latched,
            fail_stop="" if broken is None or broken.code == ENDING else f"{broken.code}: {broken.text}",
            in_doubt=dispatcher.in_doubt,
            recording=self.recording.ended,
            console=self.console.ended,
            metrics=self.metrics_trouble(),
            certificate=None if own is None else own.ends - self.machine.wall(),
            journal=self._journal(),
            tasks=self._tasks(),
            nodes=self._nodes(),
            devices=self._devices(),
            loop=LoopStatus(lag=stalls.lag, stalls=stalls.stalls, longest=stalls.longest),
            queues=self._queues(),
            strays=self.supervisor.strays,
            datagrams=self.gateway.counters.received,
            dropped=self._dropped(),
            decisions=dict(metrics.decisions),
            rejections=dict(metrics.rejections),
            latencies=metrics.latencies(),
        )

    def _journal(self) -> JournalStatus:
        broken, free = self.journal.broken, self.space.free
        return JournalStatus(
            waiting=self.journal.waiting,
            oldest_wait=self.journal.oldest_wait,
            failure="" if broken is None else broken.text,
            free=None if free is None else free * MEGABYTE,
            room=self.space.room,
        )

    def _tasks(self) -> list[TaskStanding]:
        now = self.machine.monotonic()
        return [
            TaskStanding(name=each.name, answers=each.answers(now), restarts=each.restarts)
            for each in self.supervisor.statuses()
        ]

    def _nodes(self) -> list[NodeStatus]:
        nodes = self.nodes
        return [
            NodeStatus(
                driver=driver,
                devices=devices,
                restarts=nodes.restarts.get(driver, 0),
                given_up=driver in nodes.given_up,
            )
            for driver, devices in self.drivers.items()
        ]

    def _devices(self) -> list[DeviceStatus]:
        procedure, now = self.procedure, self.machine.monotonic()
        reported = procedure.health.last
        beat_ages = {device: now - since for device, since in procedure.beat_times.items()}
        data = {device: now - since for device, since in procedure.data_times.items()}
        here = {device for devices in self.drivers.values() for device in devices}
        found = []
        for device in sorted(here | reported.keys() | beat_ages.keys()):
            # Robot and tracker may have sent data before their first health message.
            said = reported.get(device) or DeviceHealth(device=device, connected=device in data)
            status = DeviceStatus(
                device=device,
                connected=said.connected,
                text=said.text,
                heard=beat_ages.get(device),
                data=data.get(device),
                dropped=said.dropped,
            )
            found.append(status)
        return found

    def _queues(self) -> list[QueueStatus]:
        counted, dispatcher = self.bus.counters(), self.procedure.dispatcher
        full = self.procedure.command_metrics.rejections["queue_full"]
        return [
            QueueStatus(queue="bus", depth=counted["bus.waiting"], limit=CAPACITY, refused=counted["bus.refused"]),
            QueueStatus(queue="answers", depth=counted["bus.answering"], limit=ANSWERS),
            QueueStatus(queue="commands", depth=dispatcher.waiting, limit=MAX_WAITING, refused=full),
            QueueStatus(queue="journal", depth=self.journal.waiting, limit=MOST_WAITING),
        ]

    def _dropped(self) -> dict[str, int]:
        counters, bus = self.gateway.counters, self.bus.counters()
        return {
            "bus.replaced": bus["bus.replaced"],
            "bus.not_sealed": bus["bus.not_sealed"],
            "bus.ignored": bus["bus.ignored"],
            "events.misnamed": self.procedure.misnamed,
            "gateway.refused": counters.refused,
            "gateway.overflowed": counters.overflowed,
            **{f"pose.{reason}": many for reason, many in sorted(self.procedure.cell.poses.dropped.items())},
        }
