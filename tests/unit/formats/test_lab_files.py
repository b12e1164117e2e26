"""The lab's folder: found in a checkout, read as one procedure, and refused where it is not clear what is meant."""

from __future__ import annotations

from datetime import datetime
from pathlib import Path

import numpy as np
import pytest

from pcmrs.errors import FileFormatError
from pcmrs.formats.lab_files import PROCEDURE, LabProcedure, find_lab_files, procedure_texts, read_lab_procedure
from pcmrs.spatial import distance
from tests.unit.formats.lab_folder import CACHE, CLOUD, DIGITIZED, PLANNED, REG, TOOL_POSE, make_lab_folder, points_text

WHEN = datetime(2026, 1, 2, 3, 4, 5)


def read(folder: Path) -> LabProcedure:
    return read_lab_procedure(find_lab_files(folder, PROCEDURE))


def test_a_checkout_gives_the_last_procedure(tmp_path: Path) -> None:
    found = read(make_lab_folder(tmp_path))
    np.testing.assert_allclose(found.planned, PLANNED, atol=1e-15)
    np.testing.assert_allclose(np.array(found.digitized, dtype=float), DIGITIZED, atol=1e-15)
    np.testing.assert_allclose(found.surface, [*CLOUD, *-CLOUD], atol=1e-6)
    assert found.registration is not None
    assert distance(found.registration, REG) < 1e-12
    assert found.tool_pose is not None
    assert distance(found.tool_pose, TOOL_POSE) < 1e-12
    assert not found.refined


def test_what_is_written_is_read_back(tmp_path: Path) -> None:
    before = read(make_lab_folder(tmp_path / "lab"))
    (tmp_path / "ours").mkdir()
    for name, text in procedure_texts(before, WHEN).items():
        (tmp_path / "ours" / name).write_text(text)
    after = read(tmp_path / "ours")
    assert after.planned == before.planned
    assert after.digitized == before.digitized
    np.testing.assert_allclose(after.surface, before.surface, atol=1e-6)


def test_files_that_are_not_there_leave_their_part_empty(tmp_path: Path) -> None:
    assert read(tmp_path).planned == ()
    assert procedure_texts(LabProcedure(), WHEN) == {}


def test_copies_count_once_and_differing_ones_are_refused(tmp_path: Path) -> None:
    make_lab_folder(tmp_path)
    plan = tmp_path / CACHE / "landmarkplan.yaml"
    copy = tmp_path / "backup" / "landmarkplan.yaml"
    copy.parent.mkdir()
    copy.write_bytes(plan.read_bytes())
    (copy.parent / "reg_20230731_020032PM.yaml").write_text("another name")
    assert len(read(tmp_path).planned) == len(PLANNED)
    copy.write_text(plan.read_text().replace("PM", "AM"))
    with pytest.raises(FileFormatError, match=r"landmarkplan\.yaml is there 2 times with different content") as caught:
        read(tmp_path)
    assert str(plan) in caught.value.text
    assert str(copy) in caught.value.text


@pytest.mark.parametrize(
    ("changed", "reason"),
    [
        (
            {"landmarkdig": points_text("DIGITIZED", "d", DIGITIZED[:3])},
            r"landmarkdig.yaml holds 3 .* holds 4: .*two plans",
        ),
        ({"landmarkdig": points_text("PLANNED", "p", PLANNED)}, "holds planned landmarks, not digitized"),
        ({"landmarkdig": points_text("DIGITIZED", "p", DIGITIZED * [[1], [0], [1], [1]])}, "no point for landmark p1"),
        ({"landmarkdig": "DIGITIZED: {d0: {x: .nan, y: .nan, z: .nan}}"}, "holds 1 .*holds 4|no point for landmark d0"),
    ],
    ids=["another number", "another role", "zeros", "not a number"],
)
def test_a_digitization_of_another_plan_is_refused(tmp_path: Path, changed: dict[str, str], reason: str) -> None:
    with pytest.raises(FileFormatError, match=reason):
        read(make_lab_folder(tmp_path, **changed))


def test_a_missing_folder_is_refused(tmp_path: Path) -> None:
    with pytest.raises(FileFormatError, match="is not a folder"):
        find_lab_files(tmp_path / "no", PROCEDURE)
