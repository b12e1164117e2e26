"""Workflows from outside the package: where they are found, what their Python files may say, and their defaults."""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner

from pcmrs.cli import main
from pcmrs.config import as_config
from pcmrs.errors import BlueprintError, ConfigurationError
from pcmrs.settings import Settings, read_settings
from pcmrs.workflows import find_workflow, read_workflow
from pcmrs.workflows.opening import open_workflow
from pcmrs.workflows.settings import RegistrationSettings
from tests import ROOT
from tests.unit.workflows.workflow_bench import LANDMARKS, WorkflowBench, open_bench

EXAMPLES = ROOT / "examples"
BIOPSY = EXAMPLES / "biopsy" / "biopsy.toml"

LAMP = """
id = "lamp"
version = "1"
branches.lamp.states = { off = "dark", on = "lit" }
branches.lamp.operations.light = { from = ["off"], to = "on", steps = ["strike"] }
branches.lamp.operations.quench = { from = ["on"], to = "off" }
"""
STRIKE = """
from pcmrs.workflows.data import PlacementData

class Data(PlacementData, frozen=True, kw_only=True):
    strikes: int = 0

def strike(run):
    run.keep(strikes=run.data.strikes + 1)

def settle(data, states, effects):
    return data if states["lamp"] == "on" else type(data)()

def register(registry):
    registry.step(strike)
"""


def _write(folder: Path, toml: str = LAMP, code: str | None = STRIKE) -> Path:
    folder.mkdir(exist_ok=True, parents=True)
    file = folder / "lamp.toml"
    file.write_text(toml)
    if code is not None:
        file.with_suffix(".py").write_text(code)
    return file


def _install(folder: Path, monkeypatch: pytest.MonkeyPatch, name: str, module: str) -> None:
    """As an installed distribution that offers a workflow."""
    information = folder / "lamps-1.dist-info"
    information.mkdir()
    (information / "METADATA").write_text("Metadata-Version: 2.1\nName: lamps\nVersion: 1\n")
    (information / "entry_points.txt").write_text(f"[pcmrs.workflows]\n{name} = {module}\n")
    monkeypatch.syspath_prepend(str(folder))


# -- where it is --------------------------------------------------------------------------------------------


async def _lights(workflow: str) -> None:
    async with open_bench(workflow=open_workflow(workflow)) as bench:
        assert (await bench.accept("lamp.light")).state == "on"
        assert getattr(bench.data, "strikes", None) == 1
        assert (await bench.accept("lamp.quench")).state == "off"
        assert getattr(bench.data, "strikes", None) == 0


async def test_a_path_is_a_workflow(tmp_path: Path) -> None:
    await _lights(str(_write(tmp_path)))


async def test_entry_point_is_a_workflow_and_finding_it_runs_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = _write(tmp_path / "lamps" / "bright", code=f"from .. import LAMPS\n{STRIKE}")
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
    file = _write(tmp_path / "more_lamps")
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
    file = _write(tmp_path / "cell" / "my")
    config = tmp_path / "cell" / "cell.toml"
    config.write_text('workflow = "my/lamp.toml"\n')
    monkeypatch.chdir(tmp_path)
    assert Path(read_settings(config).workflow) == file
    assert Path(read_settings(None, ["workflow=cell/my/lamp.toml"]).workflow) == file
    assert Path(read_settings(config, ["workflow=cell/my/lamp.toml"]).workflow) == file
    with pytest.raises(ConfigurationError, match="no such file"):
        read_settings(config, ["workflow=my/lamp.toml"])


# -- its Python file ----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("code", "words"),
    [
        ("def register(registry:\n", ("lamp.py, line 1", "SyntaxError")),
        ("import nothing_of_this_name\n", ("lamp.py, line 1", "nothing_of_this_name")),
        ("x = 1\n\ny = x / 0\n", ("lamp.py, line 3", "ZeroDivisionError")),
        ("import sys\nsys.exit('no')\n", ("lamp.py, line 2", "SystemExit")),
        ("register = 5\n", ("lamp.py", "register(registry)")),
        ("", ("lamp.py", "register(registry)")),
        ("def register(registry):\n    registry.stap(1)\n", ("lamp.py, line 2", "stap")),
        ("def register(registry):\n    pass\n", ("lamp.toml", "lamp.light", "step", "'strike'", "lamp.py")),
        (None, ("lamp.toml", "lamp.light", "step", "'strike'", "lamp.py")),
        (STRIKE + "    registry.steps['keep_plan'] = strike\n", ("lamp.py", "'keep_plan'", "another name")),
        (STRIKE + "    registry.payload('landmarks', Data)\n", ("lamp.py", "'landmarks'", "another name")),
        ("Data = dict\n\ndef register(registry): ...\n", ("lamp.py", "Data", "PlacementData")),
        ("settle = None\n\ndef register(registry): ...\n", ("lamp.py", "settle(data, states, effects)")),
        (
            STRIKE.replace("strikes: int = 0", "@classmethod\n    def begin(cls, _): return 1 / 0"),
            ("line 6", "ZeroDiv"),
        ),
        ("async def strike(run): ...\ndef register(registry):\n    registry.step(strike)\n", ("line 3", "world_step")),
    ],
)
def test_faulty_python_file_is_reported_with_its_line(tmp_path: Path, code: str | None, words: Sequence[str]) -> None:
    file = _write(tmp_path, code=code)
    with pytest.raises((ConfigurationError, BlueprintError)) as refused:
        open_workflow(str(file))
    for word in words:
        assert word in refused.value.text


def test_reading_and_verifying_do_not_run_the_python_file(tmp_path: Path) -> None:
    file = _write(tmp_path, code="raise RuntimeError('was run')\n")
    verified = CliRunner().invoke(main, ["fsm", "verify", str(file)])
    assert verified.exit_code == 0, verified.output
    assert read_settings(None, [f"workflow={file}"]).workflow == str(file)
    with pytest.raises(ConfigurationError, match="was run"):
        open_workflow(str(file))


# -- its defaults -------------------------------------------------------------------------------------------


def _with(defaults: str) -> str:
    return f"{LAMP}\n{defaults}"


def test_workflow_defaults_lie_between_built_in_ones_and_file(tmp_path: Path) -> None:
    file = _write(
        tmp_path,
        _with(
            "[defaults.procedure.registration]\nsamples = 7\nspread_limit_mm = 3.0\n[defaults.sim]\nseed = 5\n"
            "[defaults.procedure.limits]\nbrightness = 2.0\n"
        ),
    )
    config = tmp_path / "cell.toml"
    config.write_text('workflow = "lamp.toml"\nprocedure.registration = { samples = 8, residual_limit_mm = 5.0 }\n')
    settings = read_settings(config, ["procedure.registration.residual_limit_mm=6"])
    registration = settings.procedure.registration
    assert (registration.samples, registration.spread_limit_mm, registration.residual_limit_mm) == (8, 3.0, 6.0)
    assert registration.touch_timeout_s == RegistrationSettings().touch_timeout_s
    assert settings.sim == {"seed": 5}
    assert settings.procedure.limits == {"brightness": 2.0}
    assert read_settings(None, [f"workflow={file}"]).procedure.registration.samples == 7
    shipped = as_config(Settings, read_workflow("ratms").defaults)
    assert read_settings() == shipped, "the defaults of a workflow are nobody else's"


@pytest.mark.parametrize(
    ("defaults", "words"),
    [
        ("defaults.procedure.placment.frames = 7", ("placment", "procedure")),
        ("defaults.procedure.placement.frames = 0", ("frames",)),
        ("defaults.procedure.max_pose_age = inf", ("max_pose_age", "finite")),
        ("defaults.sim.sed = 5", ("sed",)),
        ("defaults.cell.folder = '/elsewhere'", ("cell", "may change procedure.body")),
        ("defaults.procedure.patient = 'bob'", ("procedure.patient", "may change procedure.body")),
        ("defaults.procedure.placement.standoff = 0.1", ("procedure.placement", "may change procedure.body")),
        ("defaults.gateway.host = '0.0.0.0'", ("gateway", "may change procedure.body")),
        ("defaults.procedure.limits.brightness = 'much'", ("procedure.limits", "float")),
    ],
)
def test_wrong_defaults_are_refused_and_name_the_blueprint(tmp_path: Path, defaults: str, words: Sequence[str]) -> None:
    file = _write(tmp_path, _with(defaults))
    with pytest.raises(ConfigurationError) as refused:
        read_settings(None, [f"workflow={file}"])
    for word in (*words, "[defaults]", str(file)):
        assert word in refused.value.text


def test_unknown_limit_is_refused_with_those_of_the_workflow(tmp_path: Path) -> None:
    file = _write(tmp_path, _with("defaults.procedure.limits.brightness = 2"))
    assert (
        read_settings(None, [f"workflow={file}", "procedure.limits.brightness=3"]).procedure.limits["brightness"] == 3
    )
    with pytest.raises(ConfigurationError, match=r"procedure\.limits\.brigthness.*brightness"):
        read_settings(None, [f"workflow={file}", "procedure.limits.brigthness=3"])


def test_a_huge_file_is_refused_before_it_is_read_whole(tmp_path: Path) -> None:
    file = tmp_path / "lamp.toml"
    with file.open("wb") as stream:
        stream.truncate(2**40)  # of zeros, which take no place on the disk
    with pytest.raises(BlueprintError, match="too_large"):
        read_workflow(str(file))


@pytest.mark.parametrize("content", [b"\xff\xfe", b"id = ", b"id = 5", b"", b"unknown = 1\nid = 'x'\nversion = '1'"])
def test_workflow_that_is_no_blueprint_is_refused_with_its_place(tmp_path: Path, content: bytes) -> None:
    file = tmp_path / "lamp.toml"
    file.write_bytes(content)
    with pytest.raises(BlueprintError) as refused:
        read_settings(None, [f"workflow={file}"])
    assert str(file) in refused.value.text


# -- the example of the documentation -----------------------------------------------------------------------


TARGET = [0.01, 0.02, 0.05]


async def _registered(bench: WorkflowBench) -> None:
    await bench.accept("registration.plan_landmarks", landmarks=LANDMARKS)
    await bench.accept("registration.digitize_all")
    await bench.accept("registration.register")


async def _planned(bench: WorkflowBench) -> None:
    await _registered(bench)
    await bench.accept("needle.plan_path", entry=[0.01, 0.02, 0.12], target=TARGET)


async def test_the_example_takes_its_sample() -> None:
    async with open_bench(workflow=str(BIOPSY)) as bench:
        await _planned(bench)
        inserted = await bench.accept("needle.insert")
        assert inserted.result is not None
        assert 0.0 < inserted.result["distance"] <= inserted.result["limit"] == pytest.approx(0.008)
        await bench.accept("needle.sample")
        assert (await bench.accept("needle.withdraw")).state == "out"


@pytest.mark.parametrize("fault", [{"limit": 1e-3}, {"occluded": "pointer"}])
async def test_a_needle_beside_the_target_must_be_withdrawn(fault: Mapping[str, Any]) -> None:
    limits = {"limits": {"tip_tolerance_mm": fault.get("limit", 8.0)}}
    async with open_bench(limits, workflow=str(BIOPSY)) as bench:
        await _planned(bench)
        if "occluded" in fault:
            await bench.scene.occlude(fault["occluded"], True)
        code = "pose_missing" if "occluded" in fault else "target_missed"
        failed = await bench.refuse("needle.insert", code, decision="failed")
        assert failed.state == "astray"
        await bench.refuse("needle.sample", "invalid_in_state")
        assert (await bench.accept("needle.withdraw")).state == "planned"


async def test_the_example_refuses_what_it_must() -> None:
    async with open_bench(workflow=str(BIOPSY)) as bench:
        await bench.refuse("needle.plan_path", "path_too_long", entry=[0.0, 0.0, 0.2], target=TARGET)
        await bench.refuse("needle.plan_path", "bad_arguments", entry=[0.0, 0.0], target=TARGET)
        await bench.accept("needle.plan_path", entry=[0.01, 0.02, 0.12], target=TARGET)
        await bench.refuse("needle.insert", "not_registered")
        await _registered(bench)
        await bench.accept("needle.insert")
        await bench.accept("registration.register")
        assert bench.states["needle"] == "astray", "after a new registration the tip is not known to be at the target"


async def test_latched_stop_bars_the_needle_and_allows_its_withdrawal() -> None:
    async with open_bench(workflow=str(BIOPSY)) as bench:
        await _planned(bench)
        await bench.dispatcher.stop("test")
        refused = await bench.refuse("needle.insert", "latched")
        assert refused.reason is not None
        assert "safety.acknowledge" in refused.reason.text
        await bench.accept("safety.acknowledge")
        await bench.accept("needle.insert")
        await bench.dispatcher.stop("test")
        assert (await bench.accept("needle.withdraw")).state == "planned"


async def test_command_to_unknown_branch_is_rejected_and_stop_works() -> None:
    async with open_bench(workflow=str(BIOPSY)) as bench:
        await bench.refuse("robot.connect", "unknown_branch")
        await bench.refuse("placement.approach", "unknown_branch")
        await bench.dispatcher.stop("test")
        assert bench.dispatcher.snapshot().latched
