"""Responses of a muscle on the page: hidden without stimulation, and what does not count looks different."""

from __future__ import annotations

from typing import Any

import msgspec
import pytest

from pcmrs.console._colours import BLUE, GREY
from pcmrs.console.signals._muscle import MusclePanel
from pcmrs.messages import Epoch, Verdict
from pcmrs.messages.setup import ProcedureDataView, StimulationShown
from pcmrs.tms.settings import ThresholdSettings
from pcmrs.tms.threshold import MotorThresholdEstimator
from tests.unit.console.detached_page import ENGLISH, DetachedPage, ShownCell
from tests.unit.console.shown_cell import setup


def pulse(number: int, problem: str = "") -> Verdict:
    mep = {"peak_to_peak": 1e-4 * number, "latency": 0.022}
    result: dict[str, Any] = {"pulse": number, "intensity": 50.0, "mep": mep, "problem_text": problem}
    return Verdict(id="1", branch="b", operation="o", decision="accepted", state="s", sequence=1, result=result)


def stimulated(view: ShownCell, hunt: object = None) -> None:
    shown = StimulationShown(intensity=52.0, hunt=msgspec.to_builtins(hunt))
    view.data = ProcedureDataView(landmarks=[], stimulation=shown)
    view.version += 1


def test_without_stimulation_nothing_is_shown(page: DetachedPage) -> None:
    MusclePanel(ShownCell(), setup(), ENGLISH).draw()
    assert page.everything == []


def test_amplitudes_are_microvolts_and_grey_if_they_do_not_count(page: DetachedPage) -> None:
    view = ShownCell()
    view.events.extend([(1.0, pulse(1)), (2.0, pulse(2, "The muscle was active."))])
    panel = MusclePanel(view, setup(), ENGLISH)
    stimulated(view)
    panel.draw()
    (bars,) = page.at("chart-amplitudes").options["series"]
    assert [bar["value"] for bar in bars["data"]] == [[1, 100.0], [2, 200.0]]
    assert [bar["itemStyle"]["color"] for bar in bars["data"]] == [BLUE, GREY]
    assert page.text("response").endswith("The muscle was active.")
    assert "52 %" in page.text("stimulation")


def test_newest_signal_stands_out_and_scale_ignores_artefact(page: DetachedPage) -> None:
    panel = MusclePanel(view := ShownCell(), setup(), ENGLISH)
    samples = [0.0] * 1000
    samples[600] = 1.0  # 1 V at the pulse
    for number in (1, 2):
        view.epochs.append(Epoch(pulse=number, muscle="fdi", rate_hz=5000.0, start=-0.12, samples=samples))
    stimulated(view)
    panel.draw()
    chart = page.at("chart-emg")
    assert [series["color"] for series in chart.options["series"]] == [GREY, BLUE]
    assert chart.options["yAxis"]["max"] == -chart.options["yAxis"]["min"]
    assert chart.options["yAxis"]["max"] < 1000, "µV: the pulse itself would hide every response"


def test_a_finished_hunt_says_its_threshold(page: DetachedPage) -> None:
    panel = MusclePanel(view := ShownCell(), setup(), ENGLISH)
    hunt = MotorThresholdEstimator.begin(ThresholdSettings())
    stimulated(view, hunt)
    panel.draw()
    hunting = page.text("threshold")
    while not hunt.finished:
        asked = hunt.next_intensity()
        hunt = hunt.after(asked, asked >= 55.0)
    stimulated(view, hunt)
    panel.draw()
    found = page.text("threshold")
    assert found != hunting
    numbers = [float(word) for word in found.split() if word.replace(".", "", 1).isdecimal()]
    assert pytest.approx(hunt.estimate.threshold, abs=0.06) in numbers
