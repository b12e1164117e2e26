"""Named points in CSV: columns in any order, units, and files that are refused."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from pcmrs.errors import FileFormatError
from pcmrs.formats.landmarks import read_landmarks
from tests.unit.formats.landmark_files import POINTS, check_refused, csv_text


def test_columns_may_stand_in_any_order_among_others(tmp_path: Path) -> None:
    path = tmp_path / "points.csv"
    path.write_text("z_mm,comment,x_mm,name,y_mm\n\n3,first,1,a,2\n")
    found = read_landmarks(path)
    assert found.names == ("a",)
    np.testing.assert_allclose(found.points, [(0.001, 0.002, 0.003)])


def test_a_unit_may_be_given_for_columns_that_have_none(tmp_path: Path) -> None:
    path = tmp_path / "points.csv"
    path.write_text(csv_text("name,x,y,z"))
    np.testing.assert_allclose(read_landmarks(path, "mm").points, POINTS, atol=1e-15)
    path.write_text(csv_text())
    with pytest.raises(FileFormatError, match=r"columns in mm, but m was"):
        read_landmarks(path, "m")


@pytest.mark.parametrize(
    ("name", "text", "reason"),
    [
        ("a.csv", "", "is empty"),
        ("a.csv", csv_text("name,x,y,z"), "declare the unit"),
        ("a.csv", csv_text("name,x_mm,y_m,z_mm"), "three columns"),
        ("a.csv", csv_text("name,x_mm,y_mm,z_mm,x_m,y_m,z_m"), "three columns"),
        ("a.csv", csv_text("name,x_mm,x_mm,y_mm,z_mm"), "the column x_mm twice"),
        ("a.csv", csv_text().replace(",", ";"), "semicolons"),
        ("a.csv", csv_text() + "\np3,1,5,2,5,3,5\n", "more values than columns in row 6.*0,5"),
        ("a.csv", csv_text("p9,0.1,0.2,0.3"), "no column name or label"),
        ("a.csv", csv_text() + "p3,1,2\n", "row 5"),
        ("a.csv", csv_text() + "p3,1,2,inf\n", "no point for landmark p3"),
    ],
)
def test_invalid_csv_is_refused_with_file_and_reason(name: str, text: str, reason: str, tmp_path: Path) -> None:
    check_refused(tmp_path / name, text, reason)
