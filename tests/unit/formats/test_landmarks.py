"""Landmarks of every kind of file, and the pairing of planned with digitized ones."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from pcmrs.errors import GeometryError
from pcmrs.formats.grid import Role
from pcmrs.formats.landmarks import Landmarks, pair_landmarks, read_landmarks
from tests.unit.formats.landmark_files import NAMES, PLAN, POINTS, check_refused, csv_text, fcsv, lab, markups


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


@pytest.mark.parametrize(
    ("name", "text", "reason"),
    [
        ("a.txt", "", "known suffixes"),
        ("a.json", "{}", "is not a plan"),
    ],
)
def test_invalid_landmark_file_is_refused_with_file_and_reason(
    name: str, text: str, reason: str, tmp_path: Path
) -> None:
    check_refused(tmp_path / name, text, reason)


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
