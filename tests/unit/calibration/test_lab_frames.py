"""The lab's calibrations in our frames: the same pose of the arm for the same plan, whatever the tracker sees."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from pcmrs.calibration.lab_frames import LabCalibrations, lab_calibrations_of, read_lab_calibrations
from pcmrs.errors import FileFormatError
from pcmrs.formats.lab_files import CALIBRATIONS, find_lab_files
from pcmrs.formats.lab_text import lab_calibration
from pcmrs.spatial import Transform, distance, rotation_angle
from tests.unit.formats.lab_folder import (
    CNTCT_OFFSET,
    OFFSET_TOOL,
    TOOL_TOOLREF,
    TOOLREF_EFF,
    calibration_text,
    make_lab_folder,
)


def read(folder: Path, *identities: str) -> LabCalibrations:
    return read_lab_calibrations(find_lab_files(folder, CALIBRATIONS), identities)


def a_pose(rng: np.random.Generator) -> Transform:
    return Transform.from_rotvec(*rng.normal(size=(2, 3)))


@pytest.mark.parametrize("seed", range(5))
def test_the_arm_goes_where_the_labs_software_sends_it(tmp_path: Path, seed: int) -> None:
    rng = np.random.default_rng(seed)
    found = read(make_lab_folder(tmp_path))
    base_effold, pol_bodyref, pol_toolref, bodyref_body, body_cntct = (a_pose(rng) for _ in range(5))

    # As the lab's node computes it: from the measured pose of the marker body to that at the standoff before the plan.
    lab = (
        base_effold
        @ TOOLREF_EFF.inverse()
        @ pol_toolref.inverse()
        @ (pol_bodyref @ bodyref_body @ body_cntct @ CNTCT_OFFSET @ OFFSET_TOOL @ TOOL_TOOLREF @ TOOLREF_EFF)
    )

    base_from_tracker = base_effold @ found.flange_from_tool_marker @ pol_toolref.inverse()
    at_standoff = Transform.from_rotvec((0.0, 0.0, found.standoff), (0.0, 0.0, 0.0))
    base_from_tool_tip = base_from_tracker @ pol_bodyref @ bodyref_body @ body_cntct @ at_standoff
    flange_from_tool_tip = found.flange_from_tool_marker @ found.tool_marker_from_tool_tip
    ours = base_from_tool_tip @ flange_from_tool_tip.inverse()

    assert distance(ours, lab) < 1e-9
    assert rotation_angle(ours, lab) < 1e-9


def test_exported_calibrations_are_imported_unchanged(tmp_path: Path) -> None:
    before = read(make_lab_folder(tmp_path / "lab"))
    (tmp_path / "ours").mkdir()
    for name, pose in lab_calibrations_of(before).items():
        (tmp_path / "ours" / name).write_text(lab_calibration(pose))
    after = read(tmp_path / "ours")
    for name in ("flange_from_tool_marker", "tool_marker_from_tool_tip", "pointer_from_tip"):
        assert distance(getattr(after, name), getattr(before, name)) < 1e-12
        assert rotation_angle(getattr(after, name), getattr(before, name)) < 1e-12
    assert after.standoff == pytest.approx(0.07, abs=1e-12)


IDENTITY = calibration_text(Transform.identity())


@pytest.mark.parametrize(
    ("changed", "reason"),
    [
        ({"toolref_eff": None, "offset_tool": None}, r"toolref_eff.yaml, offset_tool.yaml is not there.*Add"),
        ({"ptr_ptrtip": IDENTITY}, r"ptr_ptrtip.yaml in line 1 holds the identity.*--identity-in ptr_ptrtip.yaml"),
        ({"tool_toolref": calibration_text(TOOL_TOOLREF.inverse())}, "do not fit each other.*pose of b in a"),
        ({"cntct_offset": IDENTITY}, "in line 1 holds the offset 0.0 0.0 0.0 mm.*positive z"),
        (
            {"cntct_offset": calibration_text(Transform.from_rotvec((0.0, 0.01, 0.07), (0.0, 0.0, 0.0)))},
            "0.0 10.0 70.0 mm",
        ),
        (
            {"cntct_offset": calibration_text(Transform.from_rotvec((0.0, 0.0, 0.07), (0.1, 0.0, 0.0)))},
            "turned by 5.73°",
        ),
    ],
    ids=["missing", "placeholder", "inverse", "no standoff", "sideways", "turned"],
)
def test_missing_or_ambiguous_calibrations_are_refused(
    tmp_path: Path, changed: dict[str, str | None], reason: str
) -> None:
    with pytest.raises(FileFormatError, match=reason):
        read(make_lab_folder(tmp_path, **changed))


def test_an_identity_is_taken_if_it_is_meant(tmp_path: Path) -> None:
    found = read(make_lab_folder(tmp_path, ptr_ptrtip=IDENTITY), "ptr_ptrtip.yaml")
    assert distance(found.pointer_from_tip, Transform.identity()) < 1e-12
