"""A workflow that does not declare what PCMRS's own steps do is neither sound nor started."""

from __future__ import annotations

from pathlib import Path

import pytest
from click.testing import CliRunner

from pcmrs.cli import main
from pcmrs.errors import BlueprintError
from pcmrs.workflows import find_workflow
from pcmrs.workflows.opening import open_workflow
from tests.support.shipped import NAMES, shipped_blueprint

RATMS = find_workflow("ratms").blueprint
PRESS = 'requires = { registration = ["111"], toolplan = ["1"], robot = ["1"] }\npayload = "press"'
UNDECLARED: dict[str, tuple[str, str, str]] = {
    "a motion": (
        f'motion = "approach"\n{PRESS}',
        PRESS,
        "placement.press",
    ),
    "an activity": ('ended = "following_lost", moves = true', 'ended = "following_lost"', "follow_head"),
}


@pytest.mark.parametrize("name", NAMES)
def test_workflows_of_pcmrs_are_sound(name: str) -> None:
    assert open_workflow(name).blueprint == shipped_blueprint(name)


@pytest.mark.parametrize("what", UNDECLARED)
def test_motion_must_be_declared(what: str, tmp_path: Path) -> None:
    """Undeclared, it would be accepted while Stop is latched."""
    old, new, name = UNDECLARED[what]
    text = RATMS.read_text()
    assert old in text
    file = tmp_path / "mine.toml"
    file.write_text(text.replace(old, new))
    result = CliRunner().invoke(main, ["fsm", "verify", str(file)])
    assert result.exit_code == 1
    assert f"undeclared: {name}" in result.stdout or f"undeclared: The activity {name}" in result.stdout
    with pytest.raises(BlueprintError, match=name):
        open_workflow(str(file))


def test_a_pulse_must_be_declared(tmp_path: Path) -> None:
    folder = find_workflow("ratms_threshold").blueprint.parent
    for name in ("ratms.toml", "ratms_threshold.py"):
        (tmp_path / name).write_bytes((folder / name).read_bytes())
    text = (folder / "ratms_threshold.toml").read_text()
    (tmp_path / "ratms_threshold.toml").write_text(text.replace("affects_patient = true", "affects_patient = false"))
    with pytest.raises(BlueprintError, match=r"stimulation\.fire has the step fire_pulse, which acts on the patient"):
        open_workflow(str(tmp_path / "ratms_threshold.toml"))
