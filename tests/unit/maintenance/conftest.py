"""Labs of earlier versions and of this one, in a folder of the test."""

from __future__ import annotations

import sqlite3
from pathlib import Path

import pytest

from pcmrs.journal.head import begin_head, head_path
from pcmrs.journal.keys import signing_key
from pcmrs.journal.rows import RowPosition
from tests.unit.maintenance.labs import Lab, unpacked


@pytest.fixture
def first(tmp_path: Path) -> Lab:
    """Lab of the first released version."""
    return unpacked("first", tmp_path)


@pytest.fixture
def present(tmp_path: Path) -> Lab:
    """Lab whose cell's folder has the formats of this version."""
    return unpacked("format-2", tmp_path)


@pytest.fixture
def version_2_behind(first: Lab) -> Lab:
    """Lab of the first version whose head lacks the last row, as after a crash."""
    with sqlite3.connect(first.journal) as connection:
        (last,) = connection.execute("SELECT max(sequence) FROM journal").fetchone()
        (hash_before,) = connection.execute("SELECT hash FROM journal WHERE sequence = ?", (last - 1,)).fetchone()
    connection.close()
    begin_head(head_path(first.journal), signing_key(first.cell, make=False), RowPosition(last - 1, hash_before))
    return first
