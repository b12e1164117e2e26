"""Watch for a motion of the reference against the witness, and its consequences."""

from __future__ import annotations

from collections.abc import Awaitable, Callable

from pcmrs.dispatcher import Dispatcher
from pcmrs.messages import DeviceEvent
from pcmrs.service.supervisor import mark
from pcmrs.workflows.cell import Cell
from pcmrs.workflows.data import PlacementData
from pcmrs.workflows.reference import ReferenceShift, detected_shift, shift_text

PERIOD = 0.1
"""Period of the checks, s of the cell."""

RESTS_ON_IT = ("110", "111")
"""States of the registration that a moved reference makes invalid."""

Report = Callable[[DeviceEvent], Awaitable[None]]


class ReferenceWatch:
    """Watch that reports a moved reference as danger: motion is held and latched, and the registration becomes invalid.

    If the workflow refuses that for now, as with a drill in the bone, it is reported again once the joint state has
    changed: the registration must not become valid again.

    Args:
        cell: The cell, with its tracked poses, limits and clock.
        dispatcher: The dispatcher, which takes the reports.
    """

    def __init__(self, cell: Cell, dispatcher: Dispatcher[Cell, PlacementData]) -> None:
        self._cell = cell
        self._procedure = dispatcher.procedure
        self._report: Report = dispatcher.report

    async def run(self) -> None:
        """Watch until cancelled."""
        reported: dict[str, str] = {}
        while True:
            mark()
            shift = detected_shift(self._cell, self._procedure.data)
            joint = self._procedure.joint()
            if shift is None:
                reported = {}
            elif joint != reported and joint.get("registration") in RESTS_ON_IT:
                await self._report(self._event(shift))
                reported = self._procedure.joint()
            await self._cell.clock.sleep(PERIOD)

    def _event(self, shift: ReferenceShift) -> DeviceEvent:
        fields = {"translation": shift.translation, "rotation": shift.rotation}
        text = shift_text(shift, self._cell)
        return DeviceEvent(device="tracker", code="reference_moved", text=text, danger=True, fields=fields)
