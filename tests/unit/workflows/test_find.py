"""Where workflows are found: by path, by entry point, and among those that are shipped."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from pcmrs.errors import ConfigurationError
from pcmrs.settings import read_settings
from pcmrs.workflows import find_workflow, read_workflow
from pcmrs.workflows.opening import open_workflow
from tests.unit.workflows.lamp_workflow import STRIKE, write_workflow
from tests.unit.workflows.workflow_bench import open_bench


def _install(folder: Path, monkeypatch: pytest.MonkeyPatch, name: str, module: str) -> None:
    """As an installed distribution that offers a workflow."""
    information = folder / "lamps-1.dist-info"
    information.mkdir()
    (information / "METADATA").write_text("Metadata-Version: 2.1\nName: lamps\nVersion: 1\n")
    (information / "entry_points.txt").write_text(f"[pcmrs.workflows]\n{name} = {module}\n")
    monkeypatch.syspath_prepend(str(folder))


async def _lights(workflow: str) -> None:
    async with open_bench(workflow=open_workflow(workflow)) as bench:
        assert (await bench.accept("lamp.light")).state == "on"
        assert getattr(bench.data, "strikes", None) == 1
        assert (await bench.accept("lamp.quench")).state == "off"
        assert getattr(bench.data, "strikes", None) == 0


async def test_a_path_is_a_workflow(tmp_path: Path) -> None:
    await _lights(str(write_workflow(tmp_path)))


async def test_entry_point_is_a_workflow_and_finding_it_runs_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = write_workflow(tmp_path / "lamps" / "bright", code=f"from .. import LAMPS\n{STRIKE}")
    (file.parent / "__init__.py").touch()
    (tmp_path / "lamps" / "__init__.py").write_text("LAMPS = 1\n")
    _install(tmp_path, monkeypatch, "lab_lamp", "lamps.bright.lamp")
    assert find_workflow("lab_lamp").blueprint == file
    assert read_workflow("lab_lamp").id == "lamp"
    assert read_settings(None, ["workflow=lab_lamp"]).workflow == "lab_lamp"
    assert not [name for name in sys.modules if name.split(".")[0] == "lamps"]
    await _lights("lab_lamp")
    assert "lamps.bright.lamp" in sys.modules


def test_a_name_that_two_workflows_have_is_refused_with_both(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file = write_workflow(tmp_path / "more_lamps")
    (file.parent / "__init__.py").touch()
    _install(tmp_path, monkeypatch, "ratms", "more_lamps.lamp")
    with pytest.raises(ConfigurationError) as refused:
        find_workflow("ratms")
    assert str(file) in refused.value.text
    assert "workflows/ratms.toml" in refused.value.text


@pytest.mark.parametrize("name", ["nothing_like_it", "", "ratms.tom", "../workflows/ratms"])
def test_an_unknown_name_is_refused_with_what_there_is(name: str) -> None:
    with pytest.raises(ConfigurationError) as refused:
        read_settings(None, [f"workflow={name!r}"])
    for known in ("ratms", "grid_mapping", ".toml"):
        assert known in refused.value.text


def test_entry_point_without_its_module_is_refused_with_both(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    _install(tmp_path, monkeypatch, "gone", "no_such_package.lamp")
    with pytest.raises(ConfigurationError, match=r"'gone' is installed by lamps, but its module no_such_package\.lamp"):
        find_workflow("gone")
    assert find_workflow("ratms").blueprint.name == "ratms.toml"


def test_a_path_is_relative_to_where_it_is_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file = write_workflow(tmp_path / "cell" / "my")
    config = tmp_path / "cell" / "cell.toml"
    config.write_text('workflow = "my/lamp.toml"\n')
    monkeypatch.chdir(tmp_path)
    assert Path(read_settings(config).workflow) == file
    assert Path(read_settings(None, ["workflow=cell/my/lamp.toml"]).workflow) == file
    assert Path(read_settings(config, ["workflow=cell/my/lamp.toml"]).workflow) == file
    with pytest.raises(ConfigurationError, match="no such file"):
        read_settings(config, ["workflow=my/lamp.toml"])
