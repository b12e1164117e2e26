"""The plot of a soak test has each measure of each process in its own axes, and memory in MB."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from pcmrs.testing.daemon import CHILDREN
from pcmrs_lab.campaign import soak_plot
from pcmrs_lab.campaign.soak_plot import COLOURS, draw_soak
from pcmrs_lab.campaign.soaking import ALLOWED, ResourceTrend, SoakReport


def course(process: str, measure: str, *values: float) -> ResourceTrend:
    return ResourceTrend(process, measure, [60.0 * number for number in range(len(values))], list(values), 0.0, 0.0)


def test_each_measure_has_its_axes(monkeypatch: pytest.MonkeyPatch) -> None:
    drawn: list[Any] = []
    monkeypatch.setattr(soak_plot, "save_png", lambda figure, _: drawn.append(figure))
    courses = [course("daemon", "memory", 1e6, 3e6), course("node", "memory", 2e6), course("daemon", "tasks", 7, 8, 9)]
    draw_soak(SoakReport(1.0, 1, 12, 0, {}, 1, "", courses), Path("soak.png"))
    axes = dict(zip(ALLOWED, drawn[0].axes, strict=True))
    assert axes["memory"].get_title() == "memory, MB"
    daemon, node = axes["memory"].lines
    assert (list(daemon.get_xdata()), list(daemon.get_ydata())) == ([0.0, 1.0], [1.0, 3.0])
    assert (daemon.get_color(), node.get_color()) == (COLOURS["daemon"], COLOURS["node"])
    (tasks,) = axes["tasks"].lines
    assert list(tasks.get_ydata()) == [7.0, 8.0, 9.0]
    assert len(axes["threads"].lines) == 0
    assert "12 commands" in drawn[0].get_suptitle()


def test_every_process_of_a_cell_has_a_colour() -> None:
    assert set(COLOURS) == {"daemon", *CHILDREN}
