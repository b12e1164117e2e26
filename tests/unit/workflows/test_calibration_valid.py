"""Operations that rest on a calibration refuse one that must not be used; the others do not ask."""

from __future__ import annotations

from collections.abc import Mapping
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import msgspec
import pytest

from pcmrs.calibration import Calibration, write_calibration
from pcmrs.errors import ConfigurationError
from pcmrs.fsm import Blueprint
from pcmrs.messages import PoseMessage
from pcmrs.settings import read_settings
from pcmrs.testing.clock import EPOCH
from pcmrs.workflows import read_workflow
from tests.unit.workflows.workflow_bench import LANDMARKS, WorkflowBench, open_bench

TODAY = datetime.fromtimestamp(EPOCH, UTC)
RESTING_ON_IT = {
    "registration.register",
    "registration.use_previous",
    "placement.approach",
    "placement.confirm",
    "digitization.digitize_all",
    "digitization.digitize_one",
    "digitization.reuse_previous_except",
    "registration.refine",
    "digitization.check_landmark",
    "digitization.digitize_surface",
}
WITH_A_COIL = {"placement.press", "placement.follow", "placement.guide"}
TOOL = PoseMessage(position=(0.0, 0.0, 0.15), quat_wxyz=(0.0, 1.0, 0.0, 0.0))
TIP = PoseMessage(position=(0.0, 0.0, -0.15), quat_wxyz=(1.0, 0.0, 0.0, 0.0))


def calibrated(folder: Path, kind: str, **given: Any) -> dict[str, Any]:
    """Writes a calibration that fits the simulated cell; the settings that use it."""
    values = {
        "kind": kind,
        "type": "coil" if kind == "tool" else "",
        "name": f"the {kind}",
        "cell": "lab/cell1",
        "method": "test",
        "date": TODAY,
        "valid_days": 30,
        "error_mm": 0.2,
        "transforms": {"flange_from_coil": TOOL} if kind == "tool" else {"pointer_from_tip": TIP},
    }
    write_calibration(folder / f"{kind}.toml", Calibration(**(values | given)))
    return {"calibration": {f"{kind}_file": str(folder / f"{kind}.toml")}}


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("ratms", RESTING_ON_IT | WITH_A_COIL),
        ("grid_mapping", RESTING_ON_IT | WITH_A_COIL),
        ("femoroplasty", RESTING_ON_IT),
    ],
)
def test_operations_that_need_a_calibration_check_it(name: str, expected: set[str]) -> None:
    blueprint: Blueprint = read_workflow(name)
    asking = {
        f"{branch}.{operation}"
        for branch, spec in blueprint.branches.items()
        for operation, found in spec.operations.items()
        if "calibration_valid" in found.checks
    }
    assert asking == expected


async def test_a_valid_file_takes_the_place_of_the_poses(tmp_path: Path) -> None:
    other_tip = msgspec.structs.replace(TIP, position=(0.0, 0.001, -0.15))
    async with open_bench(calibrated(tmp_path, "pointer", transforms={"pointer_from_tip": other_tip})) as bench:
        assert bench.cell.pointer_from_tip.translation.tolist() == [0.0, 0.001, -0.15]
        explicit_id = await _explicit_id()
        assert bench.cell.calibration_id != explicit_id
        await bench.accept("registration.plan_landmarks", landmarks=LANDMARKS)
        verdict = await bench.accept("digitization.digitize_one", index=0)
        assert verdict.result is not None
        assert verdict.result["calibration"] == {
            "tool": "explicit",
            "pointer": f"the pointer (version 1 of {TODAY:%Y-%m-%d})",
        }


async def test_a_tool_file_gives_the_coil_on_the_flange(tmp_path: Path) -> None:
    pose = msgspec.structs.replace(TOOL, position=(0.002, 0.0, 0.16))
    async with open_bench(calibrated(tmp_path, "tool", transforms={"flange_from_coil": pose})) as bench:
        cell = bench.cell
        assert cell.flange_from_coil.translation.tolist() == [0.002, 0.0, 0.16]
        assert (cell.flange_from_tool @ cell.tool_from_coil).matrix == pytest.approx(cell.flange_from_coil.matrix)


async def _explicit_id() -> str:
    async with open_bench() as bench:
        return bench.cell.calibration_id


@pytest.mark.parametrize(
    ("kind", "given", "code"),
    [
        ("pointer", {"date": TODAY - timedelta(days=31)}, "calibration_expired"),
        ("tool", {"date": TODAY - timedelta(days=31)}, "calibration_expired"),
        ("tool", {"date": TODAY + timedelta(days=2)}, "calibration_in_future"),
        ("tool", {"type": "drill_guide"}, "calibration_foreign"),
        ("pointer", {"cell": "lab/cell2"}, "calibration_foreign"),
    ],
)
async def test_nothing_is_digitized_with_an_unusable_calibration(
    tmp_path: Path, kind: str, given: Mapping[str, Any], code: str
) -> None:
    async with open_bench(calibrated(tmp_path, kind, **given)) as bench:
        await bench.accept("registration.plan_landmarks", landmarks=LANDMARKS)
        verdict = await bench.refuse("digitization.digitize_all", code)
        assert verdict.reason is not None
        assert "calibrat" in verdict.reason.text
        await bench.refuse("digitization.digitize_one", code, index=0)
        await bench.accept("registration.clear_landmarks")


async def test_the_mounted_tool_must_be_the_calibrated_one(tmp_path: Path) -> None:
    procedure = calibrated(tmp_path, "tool", serial="17")
    procedure["calibration"]["tool_serial"] = "18"
    async with open_bench(procedure) as bench:
        await bench.accept("registration.plan_landmarks", landmarks=LANDMARKS)
        await bench.refuse("digitization.digitize_all", "calibration_foreign")


async def test_a_changed_file_is_refused(tmp_path: Path) -> None:
    procedure = calibrated(tmp_path, "pointer")
    file = tmp_path / "pointer.toml"
    file.write_text(file.read_text().replace("-0.15", "-0.16"))
    async with open_bench(procedure) as bench:
        await bench.accept("registration.plan_landmarks", landmarks=LANDMARKS)
        await bench.refuse("digitization.digitize_all", "calibration_changed")


async def test_expired_calibration_bars_approaches_but_no_retreat(tmp_path: Path) -> None:
    async with open_bench(calibrated(tmp_path, "tool")) as bench:
        await bench.to_standoff()
        _let_expire(bench)
        await bench.refuse("placement.confirm", "calibration_expired")
        await bench.refuse("registration.use_previous", "calibration_expired")
        await bench.accept("placement.home")
        await bench.refuse("placement.approach", "calibration_expired")


def _let_expire(bench: WorkflowBench) -> None:
    calibration = bench.cell.tool_calibration
    assert calibration is not None
    old = msgspec.structs.replace(calibration, date=TODAY - timedelta(days=40))
    bench.cell.tool_calibration = msgspec.structs.replace(old, sha256=old.content_hash())


async def test_femoroplasty_needs_a_drill_guide(tmp_path: Path) -> None:
    async with open_bench(calibrated(tmp_path, "tool"), workflow="femoroplasty") as bench:
        await bench.accept("registration.plan_landmarks", landmarks=LANDMARKS)
        await bench.refuse("digitization.digitize_all", "calibration_foreign")


async def test_file_of_another_kind_is_a_bad_configuration(tmp_path: Path) -> None:
    """So is a file that cannot be read."""
    pointer = calibrated(tmp_path, "pointer")["calibration"]["pointer_file"]
    for file, words in ((pointer, "of a pointer"), (str(tmp_path / "none.toml"), "cannot be read")):
        with pytest.raises(ConfigurationError, match=words) as refused:
            async with open_bench({"calibration": {"tool_file": file}}):
                pass
        assert "procedure.calibration.tool_file" in refused.value.text


def test_paths_of_calibrations_are_relative_to_the_configuration(tmp_path: Path) -> None:
    config = tmp_path / "cell.toml"
    config.write_text('[procedure.calibration]\ntool_file = "tools/coil.toml"\n')
    calibration = read_settings(config).procedure.calibration
    assert calibration.tool_file == str(tmp_path / "tools" / "coil.toml")
    assert calibration.pointer_file == ""
    assert read_settings(None, ["procedure.calibration.pointer_file=/a/stylus.toml"]).procedure.calibration.pointer_file


def test_the_tool_of_a_workflow() -> None:
    found = {name: read_settings(None, [f"workflow={name}"]).procedure.tool for name in ("ratms", "femoroplasty")}
    assert found == {"ratms": "coil", "femoroplasty": "drill_guide"}
