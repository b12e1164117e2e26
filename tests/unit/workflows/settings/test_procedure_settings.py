"""Settings of a procedure as they are read from a configuration."""

from __future__ import annotations

from pathlib import Path

from pcmrs.settings import read_settings


def test_paths_of_calibrations_are_relative_to_the_configuration(tmp_path: Path) -> None:
    config = tmp_path / "cell.toml"
    config.write_text('[procedure.calibration]\ntool_file = "tools/coil.toml"\ntip_file = "tools/tip.toml"\n')
    calibration = read_settings(config).procedure.calibration
    assert calibration.tool_file == str(tmp_path / "tools" / "coil.toml")
    assert calibration.tip_file == str(tmp_path / "tools" / "tip.toml")
    assert calibration.pointer_file == ""
    assert read_settings(None, ["procedure.calibration.pointer_file=/a/stylus.toml"]).procedure.calibration.pointer_file


def test_the_tool_of_a_workflow() -> None:
    found = {name: read_settings(None, [f"workflow={name}"]).procedure.tool for name in ("ratms", "femoroplasty")}
    assert found == {"ratms": "coil", "femoroplasty": "drill_guide"}
