"""The table and the example of the page about scene events work as they stand there."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

from pcmrs.scene.checks import check_scene_events
from pcmrs.settings import read_settings
from pcmrs.workflows.opening import open_workflow
from tests import ROOT

PAGE = (ROOT / "docs" / "scene.md").read_text()


def block(language: str) -> str:
    (found,) = re.findall(rf"^```{language}\n(.*?)^```", PAGE, re.DOTALL | re.MULTILINE)
    return str(found)


def test_the_table_of_the_page_is_accepted(tmp_path: Path) -> None:
    file = tmp_path / "cell.toml"
    file.write_text(block("toml"))
    settings = read_settings(file)
    workflow = open_workflow(settings.workflow)
    check_scene_events(settings.scene_events, workflow.blueprint, workflow.registry.payloads)
    assert settings.scene_events.rules[0].label == settings.scene_camera.label
    assert list(settings.scene_events.sources) == [settings.scene_camera.source]


def test_the_example_of_the_page_passes() -> None:
    found: dict[str, Any] = {}
    exec(block("python"), found)
    found["test_a_cable_that_is_out_disconnects_the_robot"]()
