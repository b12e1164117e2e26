"""The chart on the page follows the states, and is drawn again only when one changes."""

from __future__ import annotations

from typing import Any

import msgspec
import pytest

from pcmrs.authoring.chart import svg
from pcmrs.console import _chart as chart
from pcmrs.console._chart import ChartPanel
from pcmrs.fsm import Blueprint
from pcmrs.messages import BlueprintTag, Snapshot
from tests.support.shipped import shipped_blueprint
from tests.unit.console.detached_page import DetachedPage

BLUEPRINT = shipped_blueprint("ratms")
START = {name: next(iter(branch.states)) for name, branch in BLUEPRINT.branches.items()}
SNAPSHOT = Snapshot(
    sequence=1, branches=START, flags={"connected": True, "armed": False}, running=[], latched=False,
    blueprint=BlueprintTag(id="ratms", version="1", hash="0"),
)  # fmt: skip


def test_states_and_flags_are_those_of_the_snapshot(page: DetachedPage) -> None:
    panel = ChartPanel(BLUEPRINT)
    panel.refresh(SNAPSHOT)
    assert page.at("chart").content == svg(BLUEPRINT, START)
    assert page.text("flags").splitlines() == ["● connected", "○ armed"]
    moved = START | {"robot": "1"}
    panel.refresh(msgspec.structs.replace(SNAPSHOT, branches=moved, flags={"connected": False}))
    assert page.at("chart").content == svg(BLUEPRINT, moved) != svg(BLUEPRINT, START)
    assert page.text("flags") == "○ connected"


def test_the_same_states_are_not_drawn_again(page: DetachedPage, monkeypatch: pytest.MonkeyPatch) -> None:
    drawn: list[Any] = []

    def draw(_blueprint: Blueprint, states: dict[str, str]) -> str:
        drawn.append(states)
        return "<svg/>"

    monkeypatch.setattr(chart, "svg", draw)
    panel = ChartPanel(BLUEPRINT)
    for sequence in range(3):
        panel.refresh(msgspec.structs.replace(SNAPSHOT, sequence=sequence))
    assert drawn == [START]
