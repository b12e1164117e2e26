"""Comparison of the latches and sessions in the nodes' heartbeats with the decisions of the daemon."""

from __future__ import annotations

from collections.abc import Callable, Iterable

from pcmrs.devices.remote import ActingDevice
from pcmrs.dispatcher import Dispatcher
from pcmrs.messages import DeviceEvent, GateState
from pcmrs.service.supervisor import Supervisor
from pcmrs.workflows.cell import Cell
from pcmrs.workflows.data import PlacementData

LATCHED = "device_latched"
"""Code of the danger event that a device is latched although the daemon is not."""


class GateWatch:
    """Watch over the gates of all devices that act.

    A device that is latched although the daemon is not has made itself safe, or its node has restarted alone: that is a
    Stop. A device that acts for an earlier daemon is held, so that no request of that daemon counts any more.

    Args:
        devices: Devices that act.
        dispatcher: The dispatcher, which has the daemon's latch.
        connected: Returns whether the robot is connected by the state of the workflow; until it first is, all devices
            are latched.
        supervisor: Supervisor of the requests to devices.
    """

    def __init__(
        self,
        devices: Iterable[ActingDevice],
        dispatcher: Dispatcher[Cell, PlacementData],
        connected: Callable[[], bool],
        supervisor: Supervisor,
    ) -> None:
        self._devices = {device.name: device for device in devices}
        self._dispatcher = dispatcher
        self._connected = connected
        self._supervisor = supervisor
        self._released = False
        self._reported: dict[str, tuple[str, int]] = {}
        self._taken_over: dict[str, tuple[str, str]] = {}

    def take(self, name: str, gate: GateState | None) -> None:
        """Follow the gate that a heartbeat reports.

        Args:
            name: Name of the device.
            gate: State of its gate; None if it has none.
        """
        device = self._devices.get(name)
        if device is None:
            return
        device.take(gate)
        self._released = self._released or self._connected()
        if device.gate is not None:
            self._take_over(device, device.gate)
            self._compare(device, device.gate)

    def _take_over(self, device: ActingDevice, gate: GateState) -> None:
        situation = (gate.node, gate.daemon)
        if device.foreign and self._taken_over.get(device.name) != situation:
            self._taken_over[device.name] = situation
            self._supervisor.spawn(f"{device.name} taken over", device.take_over())

    def _compare(self, device: ActingDevice, gate: GateState) -> None:
        name, situation = device.name, (gate.node, gate.epoch)
        if self._dispatcher.procedure.latched or not self._released or not gate.latched:
            return
        if situation not in (self._reported.get(name), device.unreleased):
            self._reported[name] = situation
            text = f"The {name} is latched without a Stop of this cell: it has stopped by itself, or its node was "
            text += "restarted. Look at it, then acknowledge."
            self._dispatcher.report_later(DeviceEvent(device=name, code=LATCHED, text=text, danger=True))
