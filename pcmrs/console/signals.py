"""Signals: how old what the cell tells is, joints and force, and how far the tool is from its plan over time."""

from __future__ import annotations

from collections import deque

import numpy as np
from nicegui import ui

from pcmrs.clock import SystemClock
from pcmrs.console.feed import Feed
from pcmrs.console.geometry import placement
from pcmrs.console.texts import Texts

SHOWN = 60.0
"""So much of the past is drawn, s."""
PERIOD = 0.25


class SignalsPanel:
    """Numbers and a trace.

    Args:
        feed: What the cell tells.
        texts: Of the page's language.
    """

    def __init__(self, feed: Feed, texts: Texts) -> None:
        self._feed, self._texts, self._clock = feed, texts, SystemClock()
        self._trace: deque[tuple[float, float | None, float | None]] = deque(maxlen=int(SHOWN / PERIOD))
        self._first_seen: np.ndarray | None = None
        self._begun = self._clock.monotonic()
        self._ages = ui.column().classes("w-full gap-0").props('data-testid="ages"')
        self._joints = ui.label().classes("text-body2").props('data-testid="joints"')
        self._force = ui.label().classes("text-body2").props('data-testid="force"')
        self._chart = ui.echart(
            {
                "animation": False,
                "grid": {"left": 45, "right": 15, "top": 30, "bottom": 25},
                "legend": {"top": 0},
                "xAxis": {"type": "value", "min": "dataMin", "max": "dataMax", "name": "s"},
                "yAxis": {"type": "value", "name": "mm"},
                "series": [
                    {"name": texts("error_now"), "type": "line", "showSymbol": False, "data": [], "color": "#d55e00"},
                    {"name": "body_ref", "type": "line", "showSymbol": False, "data": [], "color": "#0072b2"},
                ],
            }
        ).classes("w-full").style("height: 220px")  # fmt: skip
        ui.timer(PERIOD, self._follow)

    def _follow(self) -> None:
        feed = self._feed
        coil, body_ref = feed.poses.get("coil"), feed.poses.get("body_ref")
        found = placement(feed.data, coil, body_ref)
        moved = None
        if body_ref is not None and body_ref.valid:
            position = np.array(body_ref.position)
            self._first_seen = position if self._first_seen is None else self._first_seen
            moved = 1000.0 * float(np.linalg.norm(position - self._first_seen))
        self._trace.append((self._clock.monotonic() - self._begun, None if found is None else found.mm[0], moved))
        for number, series in enumerate(self._chart.options["series"], start=1):
            series["data"] = [[round(row[0], 2), row[number]] for row in self._trace]
        self._chart.update()
        self._show_numbers()

    def _show_numbers(self) -> None:
        feed, texts = self._feed, self._texts
        self._ages.clear()
        with self._ages:
            for what in ("joints", *sorted(feed.poses)):
                age, pose = feed.age(what), feed.poses.get(what)
                text = texts("not_seen") if pose is not None and not pose.valid else ""
                if not text and age is not None:
                    text = texts("age", ms=1000.0 * age)
                error = "" if pose is None or not pose.valid else f", {1000.0 * pose.error:.2f} mm"
                ui.label(f"{what}: {text or texts('unknown')}{error}")
        if feed.joints is not None:
            joints = feed.joints
            degrees = "  ".join(f"{value:7.2f}" for value in np.degrees(joints.positions))
            self._joints.set_text(f"{texts('joints')}: {degrees}")
            force = "" if joints.flange_force is None else f"{np.linalg.norm(joints.flange_force):.1f}"
            self._force.set_text(f"{texts('force')}: {force or texts('unknown')}")
