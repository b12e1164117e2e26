"""Calibration files: what is written is read, what is changed shows, what is none is refused."""

from __future__ import annotations

import tomllib
from datetime import datetime
from pathlib import Path

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pcmrs.calibration import Calibration, next_version, read_calibration, write_calibration
from pcmrs.errors import FileFormatError
from tests.unit.calibration.calibrations import DATE, a_pointer, a_tool

number = st.floats(-1.0, 1.0)


def test_written_file_is_read_back(tmp_path: Path) -> None:
    file = tmp_path / "coil.toml"
    written = write_calibration(file, a_tool(sha256=""))
    assert read_calibration(file) == written
    assert written.sha256 == written.content_hash()
    assert [left.name for left in tmp_path.iterdir()] == ["coil.toml"]
    table = tomllib.loads(file.read_text())
    assert isinstance(table["date"], datetime)
    assert (table["date"], table["schema"], table["type"]) == (DATE, 1, "coil")


@given(st.tuples(number, number, number), st.text(st.characters(exclude_categories=["C"]), max_size=20))
def test_the_hash_survives_any_value(tmp_path_factory: pytest.TempPathFactory, position: object, serial: str) -> None:
    file = tmp_path_factory.mktemp("calibration") / "c.toml"
    pose = {"position": position, "quat_wxyz": (0.6, 0.0, 0.8, 0.0)}
    table = msgspec.to_builtins(a_tool(), builtin_types=(datetime,)) | {
        "serial": serial,
        "transforms": {"flange_from_tool_marker": pose},
    }
    read = read_calibration(_written(file, msgspec.convert(table, Calibration)))
    assert read.sha256 == read.content_hash()


def _written(file: Path, calibration: Calibration) -> Path:
    write_calibration(file, calibration)
    return file


def test_hash_covers_the_values_and_not_how_they_are_written(tmp_path: Path) -> None:
    file = _written(tmp_path / "coil.toml", a_tool())
    lines = file.read_text().splitlines()
    file.write_text("# moved to another folder\n" + "\n".join(line for line in lines if not line.startswith("#")))
    read = read_calibration(file)
    assert read.sha256 == read.content_hash()


@pytest.mark.parametrize(
    ("before", "after"),
    [("0.15", "0.16"), ("MC-B70", "MC-B65"), ("valid_days = 100", "valid_days = 1000"), ("coil", "drill_guide")],
)
def test_a_changed_value_does_not_give_the_hash(tmp_path: Path, before: str, after: str) -> None:
    file = _written(tmp_path / "coil.toml", a_tool())
    file.write_text(file.read_text().replace(f'"{before}"', f'"{after}"').replace(before + ",", after + ","))
    file.write_text(file.read_text().replace(before + "\n", after + "\n"))
    read = read_calibration(file)
    assert read.sha256 != read.content_hash()


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (("schema = 1", "schema = 2"), "format 2.*reads 1 to 1"),
        (('kind = "tool"', 'kind = "pointer"'), "pointer of type"),
        (('type = "coil"', 'type = "needle"'), "type"),
        (("valid_days = 100", "valid_days = 0"), "valid_days"),
        (("error_mm = 0.3", "error_mm = nan"), "error_mm"),
        (("+00:00", ""), "date"),
        (("flange_from_tool_marker", "flange_from_tool"), "flange_from_tool_marker.*pcmrs calibrate hand-eye"),
        (("flange_from_tool_marker", "flange_from_coil"), "took the marker body.*pcmrs calibrate tip"),
        (("0.15", "inf"), "flange_from_tool_marker"),
        (('serial = "17"', "colour = 5"), "colour"),
        (("schema = 1", "schema = "), "not TOML"),
        (("version = 1", f"version = {'1' * 5000}"), "not TOML"),
        (("error_mm = 0.3", f"error_mm = 1{'0' * 400}"), "error_mm"),
    ],
)
def test_invalid_calibration_is_refused_with_the_reason(tmp_path: Path, change: tuple[str, str], words: str) -> None:
    file = _written(tmp_path / "coil.toml", a_tool())
    assert change[0] in file.read_text()
    file.write_text(file.read_text().replace(*change))
    with pytest.raises(FileFormatError, match=words) as refused:
        read_calibration(file)
    assert str(file) in refused.value.text


def test_a_missing_file_is_refused(tmp_path: Path) -> None:
    with pytest.raises(FileFormatError, match="cannot be read"):
        read_calibration(tmp_path / "nothing.toml")
    with pytest.raises(FileFormatError, match="cannot be written"):
        write_calibration(tmp_path / "no" / "folder.toml", a_tool())


def test_versions_of_one_thing_grow_and_no_other_is_overwritten(tmp_path: Path) -> None:
    file = tmp_path / "coil.toml"
    assert next_version(file, "tool", "MC-B70", "17") == 1
    write_calibration(file, a_tool(version=3))
    assert next_version(file, "tool", "MC-B70", "17") == 4
    for kind, name, serial in (("pointer", "MC-B70", "17"), ("tool", "MC-B65", "17"), ("tool", "MC-B70", "18")):
        with pytest.raises(FileFormatError, match="another tool or pointer"):
            next_version(file, kind, name, serial)  # type: ignore[arg-type]


def test_the_transform_is_that_of_the_kind() -> None:
    assert a_tool().transform().translation.tolist() == [0.001, -0.002, 0.15]
    assert a_pointer().transform().translation.tolist() == [0.0, 0.0, -0.149]
