"""Meaning of the Escape key: Stop, or the end of a dialog. Pure."""

from __future__ import annotations

from pcmrs.fsm import Blueprint
from pcmrs.fsm.exposure import Exposure
from pcmrs.messages import Snapshot


class EscapeKey:
    """Meaning of the Escape key in one workflow.

    Args:
        blueprint: The workflow.
    """

    def __init__(self, blueprint: Blueprint) -> None:
        self._blueprint = blueprint
        self._exposure = Exposure(blueprint)

    def stops(self, shown: Snapshot | None, *, dialog: bool) -> bool:
        """Return true if it is Stop; otherwise it closes the open dialog.

        It is Stop while anything moves, is armed or is at the patient, dialog or not, and whenever no dialog is open.
        If the state is not known, it is Stop.

        Args:
            shown: The present snapshot of the cell; None if it is not known.
            dialog: A dialog is open.
        """
        return not dialog or shown is None or self._is_live(shown)

    def _is_live(self, shown: Snapshot) -> bool:
        running = [self._blueprint.find(each.branch, each.operation) for each in shown.running]
        if any(spec is None or spec.moves or spec.affects_patient for spec in running):
            return True
        return self._exposure.holds(shown.branches)
