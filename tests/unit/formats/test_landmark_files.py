"""Landmark files of every kind: what is read is right, and what is not is named with file and reason."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pcmrs.errors import FileFormatError, GeometryError
from pcmrs.formats.grid import Role
from pcmrs.formats.landmarks import Landmarks, pair_landmarks, read_landmarks

POINTS = np.array([(-0.1615691632, 0.0274949, 0.003382), (0.01, -1e-05, 0.1), (0.0, 0.0949, -0.0005)])
NAMES = ("p0", "p1", "p2")


def lab(key: str = "PLANNED", names: tuple[str, ...] = NAMES, num: int = 3) -> str:
    rows = ",\n".join(
        f"    {name}: {{x: {x!r}, y: {y!r}, z: {z!r}}}" for name, (x, y, z) in zip(names, POINTS.tolist(), strict=False)
    )
    return f"NUM: {num}\n\n{key}: # in m\n\n  {{\n{rows}\n  }}\n \nTIMESTAMP: 20240102_030405AM\n"


def markups(space: str | None = "LPS", unit: str | None = "mm", **point: Any) -> dict[str, Any]:
    scale = {"m": 1.0, "um": 1e6}.get(unit or "mm", 1e3)
    signs = (1, 1, 1) if space == "RAS" else (-1, -1, 1)
    points = [
        {"id": str(index), "label": name, "position": (place * signs * scale).tolist(), "positionStatus": "defined"}
        for index, (name, place) in enumerate(zip(NAMES, POINTS, strict=True))
    ]
    points[0] |= point
    said = {"coordinateSystem": space, "coordinateUnits": unit}
    stated = {key: value for key, value in said.items() if value is not None}
    return {"@schema": "markups", "markups": [{"type": "Fiducial", **stated, "controlPoints": points}]}


def fcsv(space: str = "LPS") -> str:
    signs = (1, 1, 1) if space in ("RAS", "0") else (-1, -1, 1)
    rows = [
        f"{index},{x},{y},{z},0,0,0,1,1,1,0,{name},,"
        for index, (name, (x, y, z)) in enumerate(zip(NAMES, (POINTS * signs * 1e3).tolist(), strict=True))
    ]
    header = ["# Markups fiducial file version = 4.13", f"# CoordinateSystem = {space}"]
    columns = "# columns = id,x,y,z,ow,ox,oy,oz,vis,sel,lock,label,desc,associatedNodeID"
    return "\n".join([*header, columns, *rows]) + "\n"


def csv_text(header: str = "name,x_mm,y_mm,z_mm", scale: float = 1e3) -> str:
    rows = (f"{name},{x!r},{y!r},{z!r}" for name, (x, y, z) in zip(NAMES, (POINTS * scale).tolist(), strict=True))
    return "\n".join([header, *rows]) + "\n"


PLAN = {"landmarks": [{"name": n, "position": p} for n, p in zip(NAMES, POINTS.tolist(), strict=True)], "poses": []}


@pytest.mark.parametrize(
    ("name", "text", "role"),
    [
        ("plan.yaml", lab(), "planned"),
        ("dig.YML", lab("DIGITIZED"), "digitized"),
        ("lps.mrk.json", json.dumps(markups()), None),
        ("ras.mrk.json", json.dumps(markups("RAS")), None),
        ("metres.mrk.json", json.dumps(markups(unit="m")), None),
        ("old.mrk.json", json.dumps(markups(unit=None)), None),
        ("lps.fcsv", fcsv(), None),
        ("ras.fcsv", fcsv("RAS"), None),
        ("old_ras.fcsv", fcsv("0"), None),
        ("old_lps.fcsv", fcsv("1"), None),
        ("mm.csv", csv_text(), None),
        ("m.csv", csv_text("Label, x_m, y_m, z_m", 1.0), None),
        ("bom.csv", "\ufeff" + csv_text(), None),
        ("plan.json", json.dumps(PLAN), "planned"),
    ],
)
def test_every_kind_gives_the_same_landmarks(name: str, text: str, role: Role | None, tmp_path: Path) -> None:
    path = tmp_path / name
    path.write_text(text)
    found = read_landmarks(path)
    assert found.names == NAMES
    assert found.role == role
    np.testing.assert_allclose(found.points, POINTS, atol=1e-15)


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


def _without(content: dict[str, Any], key: str) -> str:
    del content["markups"][0][key]
    return json.dumps(content)


@pytest.mark.parametrize(
    ("name", "text", "reason"),
    [
        ("a.txt", "", "known suffixes"),
        ("a.yaml", "", "holds no keys"),
        ("a.yaml", "NUM: 3\n", "PLANNED nor DIGITIZED"),
        ("a.yaml", "PLANNED: 5\n", "no braces.* PLANNED"),
        ("a.yaml", "PLANNED: {}\n", "no landmarks"),
        ("a.yaml", "PLANNED: {p0: {x: 1, y: 2}}\n", r"x, y, z under PLANNED\.p0, not x, y"),
        ("a.yaml", "PLANNED: {p0: {x: 1, y: 2, z: true}}\n", r"PLANNED\.p0 that is not a number"),
        ("a.yaml", "PLANNED: {p0: {x: 1, y: 2, z: far}}\n", r"PLANNED\.p0 that is not a number"),
        ("a.yaml", "DIGITIZED: {d0: {x: nan, y: nan, z: nan}}\n", "no point for landmark d0.*digitize"),
        ("a.yaml", lab(num=5), "NUM: 5, but PLANNED holds 3"),
        ("a.yaml", lab(names=("p0", "p1", "p0")), "p0 is given twice"),
        ("a.yaml", "PLANNED: {p0: {x: 1", "is not YAML"),
        ("a.yaml", "PLANNED: !!python/object/apply:os.getcwd []\n", "is not YAML"),
        ("a.yaml", "WHEN: 2024-13-40\n", "is not YAML"),
        ("a.yaml", "{" * 500, "is not YAML"),
        ("a.mrk.json", "{", "not a point list of 3D Slicer"),
        ("a.mrk.json", "[" * 100_000, "not a point list of 3D Slicer"),
        ("a.mrk.json", _without(markups(), "coordinateSystem"), "coordinateSystem"),
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
        ("a.json", "{}", "is not a plan"),
    ],
)
def test_invalid_landmark_file_is_refused_with_file_and_reason(
    name: str, text: str, reason: str, tmp_path: Path
) -> None:
    path = tmp_path / name
    path.write_text(text)
    with pytest.raises(FileFormatError, match=reason) as caught:
        read_landmarks(path)
    assert str(path) in caught.value.text
    assert caught.value.fields["file"] == str(path)


def test_files_that_are_not_there_huge_or_no_text_are_refused(tmp_path: Path) -> None:
    with pytest.raises(FileFormatError, match=r"none\.yaml cannot be read: No such file"):
        read_landmarks(tmp_path / "none.yaml")
    (tmp_path / "folder.yaml").mkdir()
    with pytest.raises(FileFormatError, match="cannot be read"):
        read_landmarks(tmp_path / "folder.yaml")
    (tmp_path / "huge.csv").write_bytes(b"0" * 2_000_000)
    with pytest.raises(FileFormatError, match="longer than"):
        read_landmarks(tmp_path / "huge.csv")
    (tmp_path / "bytes.csv").write_bytes(b"name,x_mm\xff")
    with pytest.raises(FileFormatError, match="byte 9 is 0xff"):
        read_landmarks(tmp_path / "bytes.csv")


def test_pairs_go_by_name_where_both_have_the_same_names() -> None:
    digitized = Landmarks(("c", "a", "b"), np.roll(POINTS, 1, axis=0))
    pairs = pair_landmarks(Landmarks(("a", "b", "c"), POINTS), digitized)
    assert pairs.matched_by == "name"
    np.testing.assert_array_equal(pairs.digitized, pairs.planned)


@pytest.mark.parametrize("names", [("d0", "d1", "d2"), ("p0", "other", "p2")])
def test_pairs_go_by_order_where_names_differ(names: tuple[str, ...]) -> None:
    pairs = pair_landmarks(Landmarks(NAMES, POINTS), Landmarks(names, 2 * POINTS))
    assert (pairs.matched_by, pairs.names) == ("order", NAMES)
    np.testing.assert_array_equal(pairs.digitized, 2 * POINTS)


def test_landmarks_that_cannot_be_paired_are_refused() -> None:
    planned = Landmarks(NAMES, POINTS)
    with pytest.raises(GeometryError, match="3 planned landmarks but 2"):
        pair_landmarks(planned, Landmarks(NAMES[:2], POINTS[:2]))
    with pytest.raises(GeometryError, match="p1 is number 2 of the plan but number 3"):
        pair_landmarks(planned, Landmarks(("p0", "other", "p1"), POINTS))
    with pytest.raises(GeometryError, match="for the digitized landmarks says that they are planned"):
        pair_landmarks(planned, Landmarks(NAMES, POINTS, "planned"))
    with pytest.raises(GeometryError, match="for the planned landmarks says that they are digitized"):
        pair_landmarks(Landmarks(NAMES, POINTS, "digitized"), planned)
