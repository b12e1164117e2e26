"""The tables of one session."""

from __future__ import annotations

from pathlib import Path

import pytest

from pcmrs.analysis.mep_table import write_meps
from pcmrs.analysis.nibs_tables import write_nibs
from tests.support.session_records import record


@pytest.fixture(scope="module")
def nibs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    dataset = tmp_path_factory.mktemp("raw")
    write_nibs(record(), dataset)
    return dataset / "sub-phantom7" / "nibs"


@pytest.fixture(scope="module")
def emg(tmp_path_factory: pytest.TempPathFactory) -> Path:
    dataset = tmp_path_factory.mktemp("derived")
    write_meps(record(), dataset)
    return dataset / "sub-phantom7" / "emg"
