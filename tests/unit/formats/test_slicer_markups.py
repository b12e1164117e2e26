"""Point lists of 3D Slicer, in the directions and units that they declare."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pcmrs.formats._slicer_markups import read_fcsv, read_markups
from tests.unit.formats.landmark_files import check_refused, fcsv, markups, without

LENGTHS = st.floats(-500.0, 500.0)


@given(point=st.tuples(LENGTHS, LENGTHS, LENGTHS))
def test_lps_is_ras_turned_by_half_about_the_superior_axis(
    point: tuple[float, float, float], tmp_path_factory: pytest.TempPathFactory
) -> None:
    """In both kinds of file, and mm become m."""
    x, y, z = point
    folder = tmp_path_factory.mktemp("slicer")
    content = markups("LPS")
    content["markups"][0]["controlPoints"] = [{"label": "a", "position": point, "positionStatus": "defined"}]
    (folder / "a.mrk.json").write_text(json.dumps(content))
    header = "# CoordinateSystem = LPS\n# columns = id,x,y,z,label\n"
    (folder / "a.fcsv").write_text(f"{header}1,{x!r},{y!r},{z!r},a\n")
    for read, name in ((read_markups, "a.mrk.json"), (read_fcsv, "a.fcsv")):
        ((label, position),) = read(folder / name)
        assert label == "a"
        assert position == pytest.approx((-x / 1e3, -y / 1e3, z / 1e3), abs=1e-12)


@pytest.mark.parametrize(
    ("name", "text", "reason"),
    [
        ("a.mrk.json", "{", "not a point list of 3D Slicer"),
        ("a.mrk.json", "[" * 100_000, "not a point list of 3D Slicer"),
        ("a.mrk.json", without(markups(), "coordinateSystem"), "coordinateSystem"),
        ("a.mrk.json", json.dumps(markups("XYZ")), "coordinateSystem|XYZ"),
        ("a.mrk.json", json.dumps(markups(unit="inch")), "coordinateUnits|inch"),
        ("a.mrk.json", json.dumps(markups(positionStatus="undefined")), "p0 as undefined"),
        ("a.mrk.json", json.dumps(markups(label="")), "no name for its point 1"),
        ("a.mrk.json", json.dumps(markups(label="p1")), "two landmarks p1"),
        ("a.mrk.json", json.dumps({"markups": markups()["markups"] * 2}), "one point list"),
        ("a.mrk.json", json.dumps(markups()).replace("Fiducial", "Plane"), "holds Plane"),
        ("a.fcsv", fcsv().replace("# CoordinateSystem = LPS\n", ""), "CoordinateSystem"),
        ("a.fcsv", fcsv().replace("# columns", "# rows"), "columns"),
        ("a.fcsv", fcsv() + "3,1,two,3,0,0,0,1,1,1,0,q,,\n", "point 4"),
        ("a.fcsv", fcsv() + '3,"' + "1" * 200_000, "is not CSV"),
    ],
)
def test_invalid_point_list_is_refused_with_file_and_reason(name: str, text: str, reason: str, tmp_path: Path) -> None:
    check_refused(tmp_path / name, text, reason)
