"""Adapter of the daemon for the gateway: commands, and poses for clients."""

from __future__ import annotations

import asyncio

from pcmrs.bus.commands import Submit
from pcmrs.dispatcher import Dispatcher, DispatcherListener
from pcmrs.errors import RefusalError
from pcmrs.gateway.tracked_poses import TrackedPoses
from pcmrs.messages import Command, DeviceEvent, Snapshot, Verdict
from pcmrs.service.restart.state import GATEWAY, INITIAL_JOINTS
from pcmrs.spatial import Floats, Transform
from pcmrs.workflows.cell import Cell
from pcmrs.workflows.data import PlacementData, as_transform


class GatewayAdapter:
    """Implementation of `pcmrs.gateway._adapter.Core` on the dispatcher and the cell.

    Args:
        dispatcher: The dispatcher of the cell.
        cell: Devices and poses.
        submit: `Dispatcher.submit`, or a function that counts and calls it.
    """

    def __init__(
        self,
        dispatcher: Dispatcher[Cell, PlacementData],
        cell: Cell,
        submit: Submit,
    ) -> None:
        self._dispatcher = dispatcher
        self._cell = cell
        self._submit = submit

    async def submit(self, command: Command, *, arrived: float | None = None) -> Verdict:
        return await self._submit(command, arrived=arrived)

    async def stop(self, source: str) -> bool:
        return await asyncio.shield(self._dispatcher.press_stop(source).standing)

    def report(self, event: DeviceEvent) -> None:
        self._dispatcher.report_later(event)

    def add_listener(self, listener: DispatcherListener) -> None:
        self._dispatcher.add_listener(listener)

    def snapshot(self) -> Snapshot:
        return self._dispatcher.snapshot()

    def joints(self) -> list[float] | None:
        state, connected = self._cell.joints, self._dispatcher.procedure.joint().get("robot") == "1"
        return list(state.positions) if state is not None and connected else None

    async def remember_initial_joints(self) -> list[float] | None:
        joints, placement = self.joints(), self._dispatcher.procedure.joint().get("placement")
        if joints is None or placement != "retracted" or not self._dispatcher.idle:
            return None  # a posture near the body, or on the way to it, is not a place to return to
        text = "The present joints are the initial ones from now on."
        event = DeviceEvent(device=GATEWAY, code=INITIAL_JOINTS, text=text, fields={"joints": joints})
        await self._dispatcher.report(event)
        if self._dispatcher.broken is not None:  # the journal may not have them
            return None
        self._cell.initial_joints = joints
        return joints

    def flange_pose(self) -> Transform | None:
        joints = self.joints()
        return self._cell.arm.forward(joints) if joints is not None else None

    def tool_in_image(self) -> Transform | None:
        image_from_tracker, tool = self._image_from_tracker(), self._seen_tool()
        return image_from_tracker @ tool if image_from_tracker is not None and tool is not None else None

    def target_in_image(self) -> Transform | None:
        plan = self._dispatcher.procedure.data.plan
        return as_transform(plan) if plan is not None else None

    def tip_in_image(self) -> Floats | None:
        image_from_tracker = self._image_from_tracker()
        pointer = self._seen("pointer")
        if image_from_tracker is None or pointer is None:
            return None
        return image_from_tracker @ (pointer @ self._cell.pointer_from_tip.translation)

    def registration(self) -> Transform | None:
        registered = self._dispatcher.procedure.data.registered
        return as_transform(registered.body_ref_from_image) if registered is not None else None

    def data(self) -> PlacementData:
        return self._dispatcher.procedure.data

    def seen(self) -> dict[str, Transform]:
        found = {"coil": self._seen_tool(), "pointer": self._seen("pointer"), "body_ref": self._seen("body_ref")}
        return {body: pose for body, pose in found.items() if pose is not None}

    def tracked(self) -> TrackedPoses | None:
        image_from_tracker, tool = self._image_from_tracker(), self._seen_tool()
        if image_from_tracker is None or tool is None:
            return None
        return TrackedPoses(image_from_tracker @ tool, image_from_tracker.inverse(), tool)

    def _image_from_tracker(self) -> Transform | None:
        body, body_from_image = self._seen("body_ref"), self.registration()
        if body is None or body_from_image is None:
            return None
        return (body @ body_from_image).inverse()

    def _seen_tool(self) -> Transform | None:
        """Return ``tracker_from_tool_tip``; None while the tool is not seen."""
        marker = self._seen("coil")
        return None if marker is None else self._cell.mounting.tool_tip(marker)

    def _seen(self, body: str) -> Transform | None:
        try:
            return self._cell.poses.newest(body)
        except RefusalError:
            return None
