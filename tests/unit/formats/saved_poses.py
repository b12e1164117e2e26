"""Saved poses of other software, and their refusal."""

from __future__ import annotations

from pathlib import Path

import pytest

from pcmrs.errors import FileFormatError
from pcmrs.formats.pose_file import read_placements
from pcmrs.formats.pose_log import read_pose_log


def save(folder: Path, text: str, name: str = "trial_1.yaml") -> Path:
    path = folder / name
    path.write_text(text)
    return path


def refusal_of(path: Path) -> str:
    with pytest.raises(FileFormatError) as refusal:
        (read_pose_log if path.suffix == ".csv" else read_placements)(path)
    assert str(path) in refusal.value.text
    return refusal.value.text
