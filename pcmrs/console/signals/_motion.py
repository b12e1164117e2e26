"""Ages of the data, joints and force; motion of the tool against its plan, and of the body, over time."""

from __future__ import annotations

from typing import Any

import numpy as np
from nicegui import ui

from pcmrs.console._cell_view_model import CellViewModel
from pcmrs.console._colours import BLUE, VERMILION
from pcmrs.console.signals._traces import SHOWN, Moment, Traces
from pcmrs.console.texts import Texts
from pcmrs.messages.setup import Setup


class MotionPanel:
    """Numbers and two traces.

    Args:
        view: State of the cell to show.
        setup: Setup of the cell.
        texts: Texts in the language of the page.
    """

    def __init__(self, view: CellViewModel, setup: Setup, texts: Texts) -> None:
        self._view, self._texts, self._traces = view, texts, Traces(setup)
        self._ages = ui.column().classes("w-full gap-0").props('data-testid="ages"')
        self._joints = ui.label().classes("text-body2").props('data-testid="joints"')
        self._force = ui.label().classes("text-body2").props('data-testid="force"')
        self._tool = _chart(texts("error_now"))
        with ui.row().classes("items-center"):
            ui.button(texts("from_here"), on_click=self._traces.restart).props("flat no-caps dense")
        self._body = _chart(texts("body_motion"))

    def look(self) -> None:
        """Store the present moment."""
        self._traces.look(self._view)

    def draw(self) -> None:
        """Show the stored moments."""
        moments = self._traces.moments
        _draw(self._tool, [(each, each.tool) for each in moments], self._view.now)
        _draw(self._body, [(each, each.body) for each in moments], self._view.now)
        self._show_ages()
        joints, texts = self._view.joints, self._texts
        degrees = None if joints is None else "  ".join(f"{value:7.2f}" for value in np.degrees(joints.positions))
        self._joints.set_text(f"{texts('joints')}: {degrees or texts('unknown')}")
        force = None if joints is None or joints.flange_force is None else np.linalg.norm(joints.flange_force)
        self._force.set_text(f"{texts('force')}: {texts('unknown') if force is None else f'{force:.1f}'}")

    def _show_ages(self) -> None:
        view, texts = self._view, self._texts
        self._ages.clear()
        with self._ages:
            for what in ("joints", *sorted(view.poses)):
                age, pose = view.age(what), view.poses.get(what)
                text = texts("unknown") if age is None else texts("age", ms=1000.0 * age)
                if pose is not None:
                    text += f", {1000.0 * pose.error:.2f} mm" if pose.valid else f", {texts('not_seen')}"
                ui.label(f"{what}: {text}")


def _chart(title: str) -> ui.echart:
    axis = {"type": "value", "min": 0, "axisLine": {"onZero": False}, "nameGap": 8}
    return ui.echart(
        {
            "animation": False,
            "title": {"text": title, "textStyle": {"fontSize": 13}, "left": 0},
            "grid": {"left": 45, "right": 45, "top": 50, "bottom": 20},
            "legend": {"top": 0, "right": 0},
            "xAxis": {"type": "value", "min": -SHOWN, "max": 0},
            "yAxis": [{**axis, "name": "mm"}, {**axis, "name": "°", "splitLine": {"show": False}}],
            "series": [
                {**_LINE, "name": "mm", "color": VERMILION, "data": []},
                {**_LINE, "name": "°", "color": BLUE, "data": [], "yAxisIndex": 1, "lineStyle": {"type": "dashed"}},
            ],
        }
    ).classes("w-full").style("height: 200px")  # fmt: skip


_LINE: dict[str, Any] = {"type": "line", "showSymbol": False}


def _draw(chart: ui.echart, moments: list[tuple[Moment, tuple[float, float] | None]], now: float) -> None:
    """Draw millimetres and degrees over time until now, with a gap where nothing was known."""
    for number, (series, factor) in enumerate(zip(chart.options["series"], (1000.0, 180.0 / np.pi), strict=True)):
        series["data"] = [
            [round(moment.at - now, 2), None if value is None else round(factor * value[number], 3)]
            for moment, value in moments
        ]
    chart.update()
