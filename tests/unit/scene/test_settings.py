"""The table of scene events refuses what it cannot do."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from pcmrs.errors import ConfigurationError
from pcmrs.messages import SceneEvent
from pcmrs.scene.settings import SceneRuleSettings, passed_on
from pcmrs.settings import read_settings

SOURCE = '[scene_events.sources.camera]\nuser = "cam1"\n'


def event(**fields: Any) -> SceneEvent:
    return SceneEvent(source="camera", label="hand", captured=1.0, sent=1.0, session="s", **fields)


def rule(text: str) -> str:
    return f"{SOURCE}[[scene_events.rules]]\n{text}\n"


@pytest.mark.parametrize(
    ("text", "named"),
    [
        ('[[scene_events.rules]]\nlabel = "hand"\n', "no source"),
        (rule('label = "hand"\nsources = ["camera2"]'), "camera2"),
        (rule('label = "hand"\nleast_confidence = 0.1\nhysteresis = 0.1'), "never ends"),
        (rule('label = "watching"'), "sign of life"),
        (rule('label = "hand"\narguments = ["force"]'), "no arguments"),
        (rule('label = "hand"\ncalls = "a.b"\nstates = {robot = ["1"]}'), "leave out states"),
        (rule('label = "hand"\nleast_confidence = 1.5'), "1.0"),
        (rule('label = "hand"\nduration = 1.0'), "duration"),
        (SOURCE + "silent_after = 0.0\n", "silent_after"),
    ],
    ids=["no_source", "unknown", "hysteresis", "reserved", "arguments", "states", "confidence", "key", "silence"],
)
def test_table_that_cannot_work_is_refused_by_name(text: str, named: str, tmp_path: Path) -> None:
    file = tmp_path / "cell.toml"
    file.write_text(text)
    with pytest.raises(ConfigurationError, match=named):
        read_settings(file)


def test_too_many_rules_are_refused(tmp_path: Path) -> None:
    file = tmp_path / "cell.toml"
    file.write_text(SOURCE + 65 * '[[scene_events.rules]]\nlabel = "hand"\n')
    with pytest.raises(ConfigurationError, match="at most 16 and 64"):
        read_settings(file)


@pytest.mark.parametrize(
    ("keys", "counted"),
    [
        ({}, True),
        ({"sources": ("camera",), "regions": ("table",)}, True),
        ({"sources": ("other",)}, False),
        ({"regions": ("floor",)}, False),
    ],
    ids=["any", "both", "source", "region"],
)
def test_rule_counts_its_sources_and_regions(keys: dict[str, Any], counted: bool) -> None:
    assert SceneRuleSettings(label="hand", **keys).counts(event(region="table")) is counted


def test_only_named_arguments_are_passed_on() -> None:
    chosen = SceneRuleSettings(label="hand", calls="a.b", arguments=("depth", "side"))
    assert passed_on(chosen, event(arguments={"depth": 0.1, "speed": 2.0})) == {"depth": 0.1}
