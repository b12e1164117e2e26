"""Which arm a cell has, as configured."""

from pathlib import Path

import pytest

from pcmrs.errors import ConfigurationError
from pcmrs.kinematics.arms import ARMS
from pcmrs.kinematics.urdf import urdf
from pcmrs.settings import read_settings


def test_arm_path_in_a_file_is_relative_to_that_file(tmp_path: Path) -> None:
    (tmp_path / "mine.urdf").write_text(urdf(ARMS["iiwa7"]))
    (tmp_path / "cell.toml").write_text('[robot]\nmodel = "mine.urdf"\n')
    assert read_settings(tmp_path / "cell.toml").robot.model == str(tmp_path / "mine.urdf")


def test_arm_path_on_the_command_line_is_relative_to_the_cwd(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "mine.urdf").write_text(urdf(ARMS["iiwa7"]))
    monkeypatch.chdir(tmp_path)
    assert read_settings(None, ["robot.model=mine.urdf"]).robot.model == str(tmp_path / "mine.urdf")


@pytest.mark.parametrize("model", ["iiwa14", "iiwa7", "panda", "ur5"])
def test_known_arms_are_accepted(model: str) -> None:
    assert read_settings(None, [f"robot.model={model}"]).robot.model == model


@pytest.mark.parametrize(
    ("override", "text"),
    [
        ("robot.model=ur9", "'ur9' is unknown; known are iiwa14, iiwa7, panda, ur5"),
        ("robot.model=none.urdf", "none.urdf cannot be read"),
        ("procedure.home=[0.0, 0.0]", "procedure.home holds 2 numbers; iiwa14 has 7 joints"),
    ],
)
def test_an_arm_that_cannot_be_used_is_refused(override: str, text: str) -> None:
    with pytest.raises(ConfigurationError, match=text):
        read_settings(None, [override])
