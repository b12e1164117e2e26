"""Tables and sidecars keep the rules of BIDS."""

from __future__ import annotations

import math
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pcmrs.analysis._bids import Column, cell, label, write_table
from tests.unit.analysis.tables import rows, sidecar


@given(st.text())
def test_text_stays_in_its_cell(text: str) -> None:
    written = cell(text)
    assert written
    assert len(written.splitlines()) == 1
    assert "\t" not in written


@pytest.mark.parametrize(
    ("value", "written"),
    [(None, "n/a"), (math.nan, "n/a"), (math.inf, "n/a"), (True, "true"), (0, "0"), (1.0, "1"), (0.1 + 0.2, "0.3")],
)
def test_values_are_written_as_bids_has_them(value: object, written: str) -> None:
    assert cell(value) == written


@given(st.text())
def test_labels_are_letters_and_digits(text: str) -> None:
    assert label(text).isascii()
    assert label(text).isalnum()


COLUMNS: list[Column[tuple[str, float | None]]] = [
    Column("name", "Of the row", lambda row: row[0], levels={"a": "the first"}),
    Column("value", "Of the row", lambda row: row[1], "mm"),
]


@pytest.mark.parametrize("suffix", [".tsv", ".tsv.gz"])
def test_a_table_has_a_sidecar_that_describes_its_columns(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / "new" / f"sub-1_mep{suffix}"
    write_table(path, COLUMNS, [("a", 1.5), ("b", None)], TaskName="rmt")
    assert rows(path) == [{"name": "a", "value": "1.5"}, {"name": "b", "value": "n/a"}]
    assert list(sidecar(path).items()) == [
        ("TaskName", "rmt"),
        ("name", {"Description": "Of the row", "Levels": {"a": "the first"}}),
        ("value", {"Description": "Of the row", "Units": "mm"}),
    ]
    assert sorted(file.name for file in path.parent.iterdir()) == ["sub-1_mep.json", f"sub-1_mep{suffix}"]


def test_a_compressed_table_is_the_same_bytes_each_time(tmp_path: Path) -> None:
    """No time of writing is in it: a dataset can be compared by its hashes."""
    files = [tmp_path / name / "t.tsv.gz" for name in ("first", "second")]
    for file in files:
        write_table(file, COLUMNS, [("a", 1.0)])
    assert files[0].read_bytes() == files[1].read_bytes()
    assert files[0].read_bytes()[4:8] == bytes(4)
