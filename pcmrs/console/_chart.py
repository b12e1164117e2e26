"""The state chart of all branches, and the flags that mirror it."""

from __future__ import annotations

from nicegui import ui

from pcmrs.authoring.chart import svg
from pcmrs.fsm import Blueprint
from pcmrs.messages import Snapshot


class ChartPanel:
    """State chart, drawn again when a state has changed.

    Args:
        blueprint: The workflow.
    """

    def __init__(self, blueprint: Blueprint) -> None:
        self._blueprint = blueprint
        self._drawn: dict[str, str] = {}
        self._flags_drawn: dict[str, bool] = {}
        self._chart = ui.html("", sanitize=False).classes("w-full state-chart").props('data-testid="chart"')
        self._flags = ui.row().classes("q-pa-sm gap-1").props('data-testid="flags"')

    def refresh(self, shown: Snapshot) -> None:
        """Show the present states and flags."""
        if shown.branches != self._drawn:
            self._drawn = dict(shown.branches)
            self._chart.set_content(svg(self._blueprint, shown.branches))
        if shown.flags != self._flags_drawn:
            self._flags_drawn = dict(shown.flags)
            self._flags.clear()
            with self._flags:
                for name, is_set in shown.flags.items():
                    ui.badge(f"{'●' if is_set else '○'} {name}", color="blue-9" if is_set else "grey-7")
