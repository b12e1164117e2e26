"""Device nodes of this machine, as child processes of the daemon."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from contextlib import suppress
from functools import partial

import structlog

from pcmrs.clock import Clock
from pcmrs.messages import DeviceEvent
from pcmrs.processes.starting import Process, ProcessStarter
from pcmrs.service.processes.child import end_child, open_child
from pcmrs.service.supervisor import RESTARTS, WITHIN, RestartLimit, Supervisor
from pcmrs.settings import Settings

log = structlog.get_logger(__name__)

TERMINATION_TIME = 3.0
"""Limit for a node to end after SIGTERM before it is killed, s."""


class NodeProcesses:
    """Processes of the nodes, one per driver: started, restarted when they end by themselves, and ended.

    If a node ends more often than `RESTARTS` times within `WITHIN`, it is not restarted: its devices are gone until the
    daemon is restarted.

    Args:
        settings: Settings, which every node gets on its standard input.
        device_key: Key of daemon and nodes to seal their messages, which every node gets, too.
        on_end: Called with the devices of a node that has ended by itself; returns whether to restart it.
        report: Takes the event of every restart, and a danger event if a node is not restarted.
        clock: The machine's clock.
        start: Starts their processes.

    Attributes:
        restarts: Driver to the number of restarts of its node.
        given_up: Drivers whose nodes are not restarted any more.
    """

    def __init__(
        self,
        settings: Settings,
        device_key: bytes,
        on_end: Callable[[list[str]], bool],
        report: Callable[[DeviceEvent], None],
        clock: Clock,
        start: ProcessStarter,
    ) -> None:
        self._start = start
        self._settings, self._device_key = settings, device_key
        self._on_end = on_end
        self._report = report
        self._clock = clock
        self._processes: dict[str, Process] = {}
        self.restarts: dict[str, int] = {}
        self.given_up: set[str] = set()

    def start(self, supervisor: Supervisor) -> None:
        """Start the nodes of all configured drivers."""
        for driver, devices in self._settings.drivers().items():
            supervisor.start(f"node {driver}", partial(self._keep, driver, devices))

    async def stop(self) -> None:
        """End all nodes: SIGTERM, then SIGKILL."""
        for process in self._processes.values():
            with suppress(ProcessLookupError):
                process.terminate()
        for driver, process in self._processes.items():
            if not await end_child(process, TERMINATION_TIME):
                log.warning("node_killed", driver=driver)

    async def _keep(self, driver: str, devices: list[str]) -> None:
        limit = RestartLimit(RESTARTS, WITHIN, self._clock)
        while True:
            process = await open_child(
                self._start, "node", driver, *devices, settings=self._settings, device_key=self._device_key
            )
            self._processes[driver] = process
            status = await process.wait()
            log.error("node_ended", driver=driver, devices=devices, status=status)
            wanted = self._on_end(devices)
            if not wanted or limit.reached():
                if wanted:
                    self.given_up.add(driver)
                    self._report(_given_up(driver, devices))
                await asyncio.Event().wait()
            self.restarts[driver] = self.restarts.get(driver, 0) + 1
            text = f"The node of {', '.join(devices)} ended by itself (status {status}) and is restarted."
            fields = {"driver": driver, "devices": devices, "status": status}
            self._report(DeviceEvent(device="daemon", code="node_restarted", text=text, fields=fields))


def _given_up(driver: str, devices: list[str]) -> DeviceEvent:
    text = (
        f"The node of {', '.join(devices)} has ended more than {RESTARTS} times within {WITHIN:g} s and is not "
        "restarted. The log says why it ends; start the daemon again when that is fixed."
    )
    fields = {"driver": driver, "devices": devices}
    return DeviceEvent(device="daemon", code="node_failed", text=text, danger=True, fields=fields)
