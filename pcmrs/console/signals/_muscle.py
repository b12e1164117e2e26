"""Responses of a muscle: the signals of the last pulses, their amplitudes, and the motor threshold."""

from __future__ import annotations

from typing import Any

import msgspec
from nicegui import ui

from pcmrs.console._cell_view_model import CellViewModel
from pcmrs.console._colours import BLUE, GREY, ORANGE, VERMILION
from pcmrs.console.signals._responses import estimator_history, responses, waveform_points
from pcmrs.console.texts import Texts
from pcmrs.messages.setup import Setup, StimulationShown
from pcmrs.tms.settings import MepSettings

ARTEFACT = 4.0
"""Time after a pulse that does not influence the scale, ms."""


class MusclePanel:
    """Three charts, hidden in a workflow without stimulation.

    Args:
        view: State of the cell to show.
        setup: Setup of the cell.
        texts: Texts in the language of the page.
    """

    def __init__(self, view: CellViewModel, setup: Setup, texts: Texts) -> None:
        self._view, self._texts = view, texts
        self._settings = msgspec.convert(setup.mep, MepSettings)
        self._version = -1
        with ui.column().classes("w-full gap-0") as self._whole:
            self._standing = ui.label().props('data-testid="stimulation"')
            self._response = ui.label().props('data-testid="response"')
            self._emg = self._chart("emg", "ms", "µV", 200)
            self._amplitudes = self._chart("amplitudes", texts("pulse"), "µV", 160)
            self._hunt = self._chart("hunt", texts("pulse"), "%", 220)
            self._found = ui.label().props('data-testid="threshold"')

    def draw(self) -> None:
        """Show new responses."""
        if self._view.version == self._version:
            return
        self._version = self._view.version
        shown = self._view.data.stimulation
        given = responses(self._view.events)
        self._whole.set_visibility(shown is not None or bool(given))
        self._draw_amplitudes([each for each in given if each.microvolts is not None])
        if shown is not None:
            self._draw_standing(shown)
            self._draw_emg()
            self._draw_estimates(shown)
        self._emg.set_visibility(bool(self._view.epochs))
        self._hunt.set_visibility(shown is not None and shown.hunt is not None)

    def _draw_standing(self, shown: StimulationShown) -> None:
        unknown = self._texts("unknown")
        of = {key: unknown if value is None else f"{value:g} %" for key, value in _percents(shown).items()}
        self._standing.set_text(self._texts("stimulation", **of))

    def _draw_emg(self) -> None:
        """Draw the newest signal above the earlier ones, with its window and the pulse."""
        settings, drawn = self._settings, [waveform_points(each, self._settings) for each in self._view.epochs]
        window = [{"xAxis": 1000.0 * settings.window_start}, {"xAxis": 1000.0 * settings.window_end}]
        marks = {"markArea": {"silent": True, "itemStyle": {"color": "#e69f0022"}, "data": [window]}}
        self._emg.options["series"] = [
            {**_LINE, "data": points, "color": BLUE if newest else GREY, "lineStyle": {"width": 2 if newest else 1}}
            | (marks if newest else {})
            for points, newest in ((each, each is drawn[-1]) for each in drawn)
        ]
        late = [abs(value) for points in drawn for at, value in points if at > ARTEFACT]
        limit = max([60.0, *late]) * 1.1
        self._emg.options["xAxis"] |= {"min": -20, "max": 1000.0 * settings.window_end + 30.0}
        self._emg.options["yAxis"] |= {"min": -round(limit), "max": round(limit)}
        self._emg.update()

    def _draw_amplitudes(self, given: list[Any]) -> None:
        self._amplitudes.set_visibility(bool(given))
        bars = [
            {"value": [each.pulse, round(each.microvolts, 1)], "itemStyle": {"color": BLUE if each.counts else GREY}}
            for each in given
        ]
        limit = {"silent": True, "symbol": "none", "data": [{"yAxis": self._settings.threshold_uv}]}
        self._amplitudes.options["series"] = [{"type": "bar", "data": bars, "markLine": limit, "barMaxWidth": 12}]
        self._amplitudes.options["xAxis"] |= {"minInterval": 1, "scale": True}
        self._amplitudes.update()
        text, texts = "", self._texts
        if given:
            last = given[-1]
            text = texts("response", pulse=last.pulse, uv=last.microvolts)
            text += "" if last.latency is None else texts("latency_of", ms=1000.0 * last.latency)
            text += f" {last.problem}"
        self._response.set_text(text)

    def _draw_estimates(self, shown: StimulationShown) -> None:
        found = estimator_history(shown.hunt)
        if found is None:
            self._found.set_text("")
            return
        texts = self._texts
        band = {**_LINE, "lineStyle": {"opacity": 0}, "stack": "interval", "silent": True, "color": GREY}
        points = {"type": "scatter", "symbolSize": 9}
        self._hunt.options["series"] = [
            {**band, "data": found.low},
            {**band, "data": found.width, "areaStyle": {"color": "#9aa5b1", "opacity": 0.35}},
            {**_LINE, "name": texts("estimate"), "data": found.estimates, "color": ORANGE, "lineStyle": {"width": 2}},
            {**points, "name": texts("responded"), "data": found.responded, "symbol": "circle", "color": BLUE},
            {**points, "name": texts("silent"), "data": found.silent, "symbol": "triangle", "color": VERMILION},
        ]
        self._hunt.options["legend"] = {
            "top": 0,
            "right": 0,
            "data": [texts(name) for name in ("estimate", "responded", "silent")],
        }
        self._hunt.options["xAxis"] |= {"min": 1, "minInterval": 1}
        self._hunt.options["yAxis"] |= {"scale": True}
        self._hunt.update()
        self._found.set_text(texts("found" if found.finished else "hunting", method=found.method, percent=found.best))

    def _chart(self, title: str, x: str, y: str, height: int) -> ui.echart:
        options: dict[str, Any] = {
            "animation": False,
            "title": {"text": f"{self._texts(title)}, {y}", "textStyle": {"fontSize": 13}, "left": 0},
            "grid": {"left": 50, "right": 40, "top": 45, "bottom": 25},
            "xAxis": {"type": "value", "name": x},
            "yAxis": {"type": "value"},
            "series": [],
        }
        return ui.echart(options).classes("w-full").style(f"height: {height}px").props(f'data-testid="chart-{title}"')


_LINE: dict[str, Any] = {"type": "line", "showSymbol": False}


def _percents(shown: StimulationShown) -> dict[str, float | None]:
    return {"intensity": shown.intensity, "ceiling": shown.ceiling}
