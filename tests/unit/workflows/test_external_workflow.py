"""Workflows from outside the package: their defaults, and the example of the documentation."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import pytest

from pcmrs.config import as_config
from pcmrs.errors import BlueprintError, ConfigurationError
from pcmrs.settings import Settings, read_settings
from pcmrs.workflows import read_workflow
from pcmrs.workflows.settings import RegistrationSettings
from tests import ROOT
from tests.unit.workflows.lamp_workflow import LAMP, write_workflow
from tests.unit.workflows.workflow_bench import LANDMARKS, WorkflowBench, open_bench

EXAMPLES = ROOT / "examples"
BIOPSY = EXAMPLES / "biopsy" / "biopsy.toml"


def _with(defaults: str) -> str:
    return f"{LAMP}\n{defaults}"


def test_workflow_defaults_lie_between_built_in_ones_and_file(tmp_path: Path) -> None:
    file = write_workflow(
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
    file = write_workflow(tmp_path, _with(defaults))
    with pytest.raises(ConfigurationError) as refused:
        read_settings(None, [f"workflow={file}"])
    for word in (*words, "[defaults]", str(file)):
        assert word in refused.value.text


def test_unknown_limit_is_refused_with_those_of_the_workflow(tmp_path: Path) -> None:
    file = write_workflow(tmp_path, _with("defaults.procedure.limits.brightness = 2"))
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
